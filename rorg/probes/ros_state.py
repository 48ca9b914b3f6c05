"""Reads everything that is registered at a ROS 1 master, with the addresses of the nodes; and unregisters nodes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from rorg.host.bounded_http import connect, place_of
from rorg.host.deadline import Deadline
from rorg.probes.ros_master import CALLER, TIMEOUT, Graph, ask, call, graph, value_of

READING = 5.0
"""Seconds for the whole state of a master."""


@dataclass(frozen=True, slots=True)
class RosState:
    """The state of one master. `graph`: publishers, subscribers and services."""

    graph: Graph
    places: dict[str, str]
    """Node -> URI of its XML-RPC, if it was still registered when asked for."""


def read_state(master: str) -> RosState:
    """Read it in two calls for any number of nodes. Raises OSError if there is no master."""
    deadline = Deadline.within(READING)
    ros_graph = graph(master, deadline.sooner(TIMEOUT))
    nodes = sorted({n for part in ros_graph for names in part.values() for n in names})
    return RosState(ros_graph, _places(master, nodes, deadline) if nodes else {})


def _places(master: str, nodes: Iterable[str], deadline: Deadline) -> dict[str, str]:
    """Raises OSError."""
    names = list(nodes)
    calls = [{"methodName": "lookupNode", "params": [CALLER, node]} for node in names]
    answers = ask(master, "system.multicall", calls, deadline=deadline)
    if not (isinstance(answers, list) and len(answers) == len(names)):
        raise OSError("its answer is not that of a ROS master")
    return {node: uri for node, said in zip(names, answers, strict=True) if (uri := _place(said))}


def _place(said: Any) -> str:
    """The URI in one answer of a multicall, which is in a list of its own; empty if there is none."""
    try:
        return str(value_of(said[0])) if isinstance(said, list) and len(said) == 1 else ""
    except (LookupError, OSError):
        return ""


def refuses(uri: str) -> bool:
    """Whether nothing listens there, because the connection is refused. A paused program accepts it; what does not
    answer in time may be anything."""
    try:
        connect(*place_of(uri), Deadline.within(TIMEOUT)).close()
    except ConnectionRefusedError:
        return True
    except OSError:
        pass
    return False


def unregister(master: str, node: str, state: RosState) -> None:
    """Unregister everything that this node registered from its address in the state. Registrations from other
    addresses, of its own or of another node of that name, stay. Raises OSError; LookupError if the master no longer
    knows it."""
    deadline, uri = Deadline.within(READING), state.places[node]
    if call(master, "lookupNode", CALLER, node, deadline=deadline) != uri:
        raise LookupError(f"{node} is at another address now")
    publishers, subscribers, services = state.graph
    told = [("unregisterPublisher", topic, uri) for topic, names in publishers.items() if node in names]
    told += [("unregisterSubscriber", topic, uri) for topic, names in subscribers.items() if node in names]
    told += [
        ("unregisterService", service, str(call(master, "lookupService", CALLER, service, deadline=deadline)))
        for service, names in services.items()
        if node in names
    ]
    for method, name, where in told:
        call(master, method, node, name, where, deadline=deadline)
