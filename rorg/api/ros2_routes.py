"""The route by which a node of ROS 2 reports the graph, and gets what rorg asks of it."""

from __future__ import annotations

import asyncio
import contextlib
from typing import Annotated, Any, Literal

from fastapi import FastAPI, Path, Query
from fastapi.responses import JSONResponse, Response
from pydantic import BaseModel, Field

from rorg.api.callers import Who, needs
from rorg.api.events import from_any_thread
from rorg.api.inputs import Body
from rorg.api.operations import Operations
from rorg.api.permissions import allow_report
from rorg.core.ros_graph import RosGraph
from rorg.probes.ros2_exchange import Orders, Report, State, answer_of

LONGEST = 10.0
"""Seconds that a reporter may wait for orders."""
GATHER = 0.002
"""Seconds for which orders are gathered: probes are often due together."""
Name = Annotated[str, Field(max_length=256)]
Names = Annotated[list[Name], Field(max_length=5000)]
Ends = dict[Name, Names]
Domain = Annotated[int, Path(ge=0, le=232)]
Session = Annotated[str, Field(pattern=r"^[A-Za-z0-9-]{8,64}$")]
Wait = Annotated[float, Query(ge=0, le=LONGEST, description="Wait this long at most for something to do.")]


class Ros2Graph(Body):
    """All nodes, and by topic or service the nodes at its ends."""

    nodes: Names
    publishers: Ends = {}
    subscribers: Ends = {}
    providers: Ends = {}
    callers: Ends = {}


class Ros2State(Body):
    """The state of one managed node."""

    label: Literal["unconfigured", "inactive", "active", "finalized", "other"]
    age: Annotated[float, Field(ge=0, le=3600)] = Field(description="Seconds since the node was asked.")


class Ros2Answer(Body):
    """The answer to one order."""

    ok: bool
    message: Annotated[str, Field(max_length=1000)] = ""
    asked: bool = Field(True, description="False if the order could not be carried out, so nothing was learned.")


class PutReport(Body):
    """News from a reporter. Without a graph, the graph is as before."""

    session: Session = Field(description="One run of the reporter.")
    graph: Ros2Graph | None = None
    states: Annotated[dict[Name, Ros2State], Field(max_length=1000)] = {}
    answers: Annotated[dict[Annotated[str, Field(max_length=20)], Ros2Answer], Field(max_length=1000)] = {}


class Ros2Order(BaseModel):
    """Something that the reporter of a ROS 2 graph has to do once."""

    id: str = Field(description="Names it in the answer.")
    kind: str = Field(
        description="ros_node, ros_topic, ros_rate, ros_service, ros_action, ros_parameter or lifecycle: answer that "
        "form of probe; activate or deactivate: managed nodes, one after another; ros_parameters: set `values`."
    )
    target: list[str] = Field(description="The words of the probe, or the nodes.")
    run_age: float = Field(description="Seconds since the run began. Endpoints seen before belong to another run.")
    values: dict[str, Any] = Field(description="Parameters by absolute name; the last part is the parameter.")
    timeout: float = Field(description="Seconds after which rorg no longer waits for the answer.")


class Ros2Orders(BaseModel):
    """News for the reporter of a ROS 2 graph."""

    graph: bool = Field(description="Whether rorg has a graph of this session; if not, send it again.")
    orders: list[Ros2Order]
    watched: list[str] | None = Field(description="Nodes whose states it reports; null if they are as before.")


def add_ros2(app: FastAPI, operations: Operations) -> None:
    """Adds the route."""

    @app.post("/v1/ros2/{domain}", dependencies=[needs("report")], response_model=Ros2Orders)
    async def report(domain: Domain, body: PutReport, caller: Who, wait: Wait = 0.0) -> Response:
        """Report the graph of a ROS 2 domain, and get what rorg asks of it. Call it whenever there is something to
        report, and beside that once a second with `wait`."""
        allow_report(caller, operations.catalog)
        exchange = operations.ros2
        exchange.report(domain, caller.identity, body.session, _report(body, exchange.clock()), _answers(body))
        turn, until = asyncio.Event(), asyncio.get_running_loop().time() + wait
        with exchange.listening(domain, from_any_thread(turn)):
            while True:
                turn.clear()
                orders = exchange.orders(domain, body.session)
                left = until - asyncio.get_running_loop().time()
                if orders is not None or left <= 0 or operations.ending:
                    return JSONResponse({"graph": exchange.has_graph(domain, body.session), **_as_json(orders)})
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(turn.wait(), left)
                    await asyncio.sleep(GATHER)


def _report(body: PutReport, now: float) -> Report:
    states = {node: State(state.label, now - state.age) for node, state in body.states.items()}
    if body.graph is None:
        return Report(None, states)
    graph = RosGraph(
        nodes=dict.fromkeys(body.graph.nodes, ""),
        publishers=_sorted(body.graph.publishers),
        subscribers=_sorted(body.graph.subscribers),
        providers=_sorted(body.graph.providers),
        callers=_sorted(body.graph.callers),
    )
    return Report(graph, states)


def _sorted(ends: Ends) -> dict[str, tuple[str, ...]]:
    return {name: tuple(sorted(nodes)) for name, nodes in ends.items()}


def _answers(body: PutReport) -> dict[str, Any]:
    return {id: answer_of(answer.ok, answer.message, answer.asked) for id, answer in body.answers.items()}


def _as_json(orders: Orders | None) -> dict[str, Any]:
    if orders is None:
        return {"orders": [], "watched": None}
    fields = ("id", "kind", "run_age", "timeout")
    told = [
        {**{f: getattr(order, f) for f in fields}, "target": list(order.target), "values": dict(order.values)}
        for order in orders.orders
    ]
    return {"orders": told, "watched": list(orders.watched)}
