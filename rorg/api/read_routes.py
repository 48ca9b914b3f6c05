"""Routes that read: services, groups, images, requests, status, plan, usage."""

from __future__ import annotations

import json
from typing import Annotated, Any

from fastapi import FastAPI, Path, Query
from fastapi.responses import Response

from rorg.api import views
from rorg.api.callers import needs
from rorg.api.generations import until
from rorg.api.models import (
    Graph,
    GroupView,
    ImageGraph,
    ImageView,
    ProcessView,
    RequestView,
    ServiceView,
    Usage,
    Why,
)
from rorg.api.operations import Operations
from rorg.api.permissions import allow, allow_call
from rorg.api.status_models import EngineView, PlanView, StatusView, SummaryView
from rorg.api.why import why_active
from rorg.daemon.snapshot import engine_json
from rorg.errors import RorgError

Seconds = Annotated[
    float,
    Query(ge=0, le=60, description="Wait this long at most until nothing is under way and no service is coming up."),
]
Port = Annotated[int, Path(ge=1, le=65535)]


def text(value: Any) -> Response:
    """A value as JSON, without validation for speed: it has the fields of its model, as a test checks."""
    return Response(json.dumps(value), media_type="application/json")


def add_reading(app: FastAPI, operations: Operations) -> None:
    """Adds the routes."""
    _add_services(app, operations)
    read = [needs("read")]

    @app.get("/v1/groups", dependencies=read, response_model=list[GroupView])
    async def groups() -> Response:
        """The declared groups."""
        return text(views.groups(operations.catalog))

    @app.get("/v1/images", dependencies=read, response_model=list[ImageView])
    async def images() -> Response:
        """The declared images."""
        return text(views.images(operations.catalog))

    @app.get("/v1/graph", dependencies=read, response_model=Graph)
    async def graph() -> Response:
        """Who needs and who requests whom."""
        return text(views.graph(operations.catalog, operations.decision.settled.requests))

    @app.get("/v1/graph/images", dependencies=read, response_model=ImageGraph)
    async def image_graph() -> Response:
        """The base images of each image."""
        return text(views.image_graph(operations.catalog))

    @app.get("/v1/requests", dependencies=read, response_model=list[RequestView])
    async def requests() -> Response:
        """All requests that count, standing ones included."""
        return text(views.requests(operations.current))

    _add_status(app, operations)


def _add_status(app: FastAPI, operations: Operations) -> None:
    @app.get("/v1/status", dependencies=[needs("plan")], response_model=StatusView)
    async def status(settled: Seconds = 0.0) -> Response:
        """The whole state in one answer: the tree, the engine, requests, pressure, the plan, all services."""
        if settled:  # finding out whether all is at rest looks at every service
            await until(operations, lambda: operations.at_rest or operations.ending, settled)
        return Response(operations.snapshot(), media_type="application/json")

    @app.get("/v1/summary", dependencies=[needs("plan")], response_model=SummaryView)
    async def summary() -> Response:
        """The robot in a few words, for lists of many robots."""
        return text(views.summary(operations.current, operations.about_tree(), operations.machines.here))

    @app.get("/v1/engine", dependencies=[needs("read")], response_model=EngineView)
    async def engine() -> Response:
        """Whether the engine answers. While it does not, states of services are those seen last."""
        return text(engine_json(operations.decision.situation.observed))

    @app.get("/v1/plan", dependencies=[needs("plan")], response_model=PlanView)
    async def plan() -> Response:
        """The actions that rorg would take, and which of them wait for others."""
        return text(operations.decision.plan.as_json())


def _add_services(app: FastAPI, operations: Operations) -> None:
    read = [needs("read")]

    @app.get("/v1/services", dependencies=read, response_model=list[ServiceView])
    async def services() -> Response:
        """The state of every service."""
        return Response(
            b"[" + b",".join(operations.service_text(n) for n in operations.statuses()) + b"]",
            media_type="application/json",
        )

    @app.get("/v1/services/{name}", dependencies=read, response_model=ServiceView)
    async def service(name: str) -> Response:
        """The state of one service."""
        return Response(operations.service_text(name), media_type="application/json")

    @app.get("/v1/services/{name}/why", dependencies=read, response_model=list[Why])
    async def why(name: str) -> Response:
        """Why a service, or each of a group, is active, or why not."""
        return text(why_active(operations.current, name))

    @app.get("/v1/listeners/{port}", dependencies=read, response_model=ProcessView)
    def listener(port: Port) -> Response:
        """The process, and its service, that listens at a TCP port of this machine: tells a bridge whose node it is."""
        return text(operations.listener(port))

    @app.get("/v1/connections/{port}", dependencies=read, response_model=ProcessView)
    def connection(port: Port, to: Annotated[int, Query(ge=1, le=65535, description="Its other end.")]) -> Response:
        """The process, and its service, that has a TCP connection from a port of this machine: tells a bridge who
        calls."""
        return text(operations.connection(port, to))

    @app.get("/v1/usage", dependencies=read, response_model=Usage)
    def usage() -> Response:
        """CPU seconds and memory of each running service, and of the machine."""
        return text(operations.usage())


class Quick:
    """Answers the state of one service without FastAPI, which takes most of the time: programs ask this all the time.
    Everything but plain success is left to the application."""

    PREFIX = "/v1/services/"

    def __init__(self, app: Any, operations: Operations) -> None:
        self.app, self.operations = app, operations

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        asked = scope.get("method") == "GET" and scope["path"].startswith(self.PREFIX)
        name = scope["path"][len(self.PREFIX) :] if asked else "/"
        if "/" not in name:
            try:
                allow(scope["state"]["caller"], "read")
                allow_call(scope["state"]["caller"], self.operations.catalog)
                body = self.operations.service_text(name)
            except RorgError:
                pass
            else:
                headers = [(b"content-type", b"application/json"), (b"content-length", str(len(body)).encode())]
                await send({"type": "http.response.start", "status": 200, "headers": headers})
                await send({"type": "http.response.body", "body": body})
                return
        await self.app(scope, receive, send)
