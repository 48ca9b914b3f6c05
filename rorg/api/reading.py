"""Routes that read: services, groups, images, requests, the plan."""

from __future__ import annotations

import json
from typing import Annotated, Any

from fastapi import FastAPI, Path
from fastapi.responses import Response

from rorg.api import views
from rorg.api.callers import needs
from rorg.api.models import GroupView, ImageView, Listener, RequestView, ServiceView, Usage, Why
from rorg.api.operations import Operations
from rorg.api.status_models import PlanView, StatusView


def add_reading(app: FastAPI, operations: Operations) -> None:
    """The routes."""
    read = [needs("read")]

    def text(value: Any) -> Response:
        return Response(json.dumps(value), media_type="application/json")

    @app.get("/v1/services", dependencies=read, response_model=list[ServiceView])
    async def services() -> Response:
        """How every service is."""
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

    @app.get("/v1/groups", dependencies=read, response_model=list[GroupView])
    async def groups() -> Response:
        """The declared groups."""
        return text(views.groups(operations.catalog))

    @app.get("/v1/images", dependencies=read, response_model=list[ImageView])
    async def images() -> Response:
        """The declared images."""
        return text(views.images(operations.catalog))

    @app.get("/v1/requests", dependencies=read, response_model=list[RequestView])
    async def requests() -> Response:
        """All requests that count, standing ones included."""
        return text(operations.requests())

    @app.get("/v1/status", dependencies=[needs("plan")], response_model=StatusView)
    async def status() -> Response:
        """Everything at once: the tree, the engine, requests, pressure, the plan, all services."""
        return text(operations.snapshot())

    @app.get("/v1/plan", dependencies=[needs("plan")], response_model=PlanView)
    async def plan() -> Response:
        """What is to be done, and what waits for what."""
        return text(operations.decision.plan.as_json())

    @app.get("/v1/listeners/{port}", dependencies=read, response_model=Listener)
    def listener(port: Annotated[int, Path(ge=1, le=65535)]) -> Response:
        """Which service listens at a TCP port of this machine: tells a bridge whose program calls it."""
        return text({"port": port, "service": operations.listener(port)})

    @app.get("/v1/usage", dependencies=read, response_model=Usage)
    def usage() -> Response:
        """CPU seconds and memory of each service that runs, and of the machine."""
        return text(operations.usage())
