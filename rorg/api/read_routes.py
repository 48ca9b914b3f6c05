"""Routes that read: services, groups, images, requests, the plan."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Callable
from typing import Annotated, Any

from fastapi import FastAPI, Path, Query
from fastapi.responses import Response

from rorg.api import views
from rorg.api.callers import needs
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
from rorg.api.status_models import EngineView, PlanView, StatusView
from rorg.daemon.snapshot import engine_json

Seconds = Annotated[
    float,
    Query(
        ge=0, le=60, description="Answer when nothing is under way and no service is on its way; so late at the most."
    ),
]
Port = Annotated[int, Path(ge=1, le=65535)]


def text(value: Any) -> Response:
    """A value as JSON, unchecked: what is answered is made of the models' fields, and a test holds it to them."""
    return Response(json.dumps(value), media_type="application/json")


def add_reading(app: FastAPI, operations: Operations, changed: Callable[[], asyncio.Event]) -> None:
    """The routes."""
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
        """What images stand on."""
        return text(views.image_graph(operations.catalog))

    @app.get("/v1/requests", dependencies=read, response_model=list[RequestView])
    async def requests() -> Response:
        """All requests that count, standing ones included."""
        return text(operations.requests())

    _add_status(app, operations, changed)


def _add_status(app: FastAPI, operations: Operations, changed: Callable[[], asyncio.Event]) -> None:
    @app.get("/v1/status", dependencies=[needs("plan")], response_model=StatusView)
    async def status(settled: Seconds = 0.0) -> Response:
        """Everything at once: the tree, the engine, requests, pressure, the plan, all services."""
        await _settled(operations, settled, changed)
        return text(operations.snapshot())

    @app.get("/v1/engine", dependencies=[needs("read")], response_model=EngineView)
    async def engine() -> Response:
        """Whether the engine answers. While it does not, states of services are those that were seen last."""
        return text(engine_json(operations.decision.situation.observed))

    @app.get("/v1/plan", dependencies=[needs("plan")], response_model=PlanView)
    async def plan() -> Response:
        """What is to be done, and what waits for what."""
        return text(operations.decision.plan.as_json())


async def _settled(operations: Operations, seconds: float, changed: Callable[[], asyncio.Event]) -> None:
    """Returns when everything is at rest, or after so many seconds."""
    clock = asyncio.get_running_loop().time
    end = clock() + seconds
    while clock() < end:
        event = changed()
        if operations.at_rest or operations.ending:
            return
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(event.wait(), end - clock())


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
        """How one service is."""
        return Response(operations.service_text(name), media_type="application/json")

    @app.get("/v1/services/{name}/why", dependencies=read, response_model=list[Why])
    async def why(name: str) -> Response:
        """Why a service, or each of a group, is active, or why not."""
        return text(operations.why(name))

    @app.get("/v1/listeners/{port}", dependencies=read, response_model=ProcessView)
    def listener(port: Port) -> Response:
        """Which process, of which service, listens at a TCP port of this machine: tells a bridge whose node it is."""
        return text(operations.listener(port))

    @app.get("/v1/connections/{port}", dependencies=read, response_model=ProcessView)
    def connection(port: Port, to: Annotated[int, Query(ge=1, le=65535, description="Its other end.")]) -> Response:
        """Which process, of which service, has a TCP connection from a port of this machine: who calls a bridge."""
        return text(operations.connection(port, to))

    @app.get("/v1/usage", dependencies=read, response_model=Usage)
    def usage() -> Response:
        """CPU seconds and memory of each service that runs, and of the machine."""
        return text(operations.usage())
