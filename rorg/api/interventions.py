"""Routes by which people intervene: restart, retry, hold, suspend, confirm removals, fetch, take the robot down."""

from __future__ import annotations

import asyncio
import time
from typing import Annotated, Any

from fastapi import FastAPI, Query
from fastapi.responses import Response

from rorg.api import changes
from rorg.api.callers import Requester, Who, accepted, applied, needs
from rorg.api.inputs import ConfirmBody, DownBody, HoldBody, SuspendBody, seconds_of
from rorg.api.models import Held
from rorg.api.operations import Operations
from rorg.api.permissions import allow_restart
from rorg.api.status_models import GitView
from rorg.host.clock import moment


def add_operating(app: FastAPI, operations: Operations) -> None:
    """Adds the routes."""
    _add_holds(app, operations)
    _add_down(app, operations)
    for call, operation in changes.OPERATIONS.items():
        _add_operation(app, operations, call, operation)

    @app.post("/v1/services/{name}/restart", dependencies=[needs("restart")], response_model=Held)
    async def restart(  # caller_of reads the requester; here it is for the schema
        name: str,
        caller: Who,
        force: bool = False,
        requester: Requester = None,  # noqa: ARG001
    ) -> Response:
        """Stop and start a service, or each of a group. If that stops a driver or other services, it needs `force`: the
        refusal names them in `confirm`."""
        allow_restart(caller, name, operations.catalog)
        return await applied(operations, caller, changes.restart(operations.current, name, force, time.time()), True)

    @app.put("/v1/removals", dependencies=[needs("removals")], status_code=204, response_class=Response)
    async def confirm(body: ConfirmBody, caller: Who) -> Response:
        """Confirm the removal of what no manifest declares any more, although a request, a need or a group named it."""
        return await applied(operations, caller, changes.confirm(operations.current, tuple(body.services)))

    @app.post("/v1/fetch", dependencies=[needs("fetch")], response_model=GitView)
    async def fetch(
        seconds: Annotated[float, Query(ge=0, le=60, description="Longest time to wait for it.")] = 8.0,
    ) -> Response:
        """Fetch the repository that rorg follows now, and answer with the result. Refused if rorg follows none."""
        return accepted(*await asyncio.to_thread(operations.fetch, seconds))


def _add_operation(app: FastAPI, operations: Operations, call: str, operation: changes.Operation) -> None:
    async def change(body: Any, caller: Who) -> Response:
        return await applied(operations, caller, operation.change(operations.current, body, moment()), True)

    change.__annotations__["body"] = operation.body
    method, path = call.split()
    app.add_api_route(
        path,
        change,
        methods=[method],
        name=operation.name,
        description=operation.about,
        dependencies=[needs(operation.name)],
        response_model=Held,
    )


def _add_down(app: FastAPI, operations: Operations) -> None:
    @app.put("/v1/down", dependencies=[needs("down")], status_code=204, response_class=Response)
    async def down(body: DownBody, caller: Who) -> Response:
        """Stop and remove everything, in order, regardless of requests; then rorg ends. The robot stays down until a
        person runs rorg again. Its history stays unless it is forgotten."""
        suspended = operations.decision.situation.suspended
        return await applied(operations, caller, changes.down(body.keep_requests, body.volumes, body.forget, suspended))

    @app.delete("/v1/down", dependencies=[needs("down")], status_code=204, response_class=Response)
    async def up(caller: Who) -> Response:
        """Bring the robot up after it was taken down."""
        return await applied(operations, caller, changes.up())


def _add_holds(app: FastAPI, operations: Operations) -> None:
    async def held(caller: Who, body: changes.HoldsBody, named: bool = True) -> Response:
        return await applied(operations, caller, changes.hold(operations.current, body, moment()), named)

    @app.put("/v1/holds/{name}", dependencies=[needs("hold")], response_model=Held)
    async def hold(name: str, body: HoldBody, caller: Who) -> Response:
        """Keep a service, or those of a group, from being active for a time, regardless of requests. If that stops a
        driver or other services, it needs `force`: the refusal names them in `confirm`."""
        return await held(caller, changes.HoldsBody.model_construct(services=[name], **body.model_dump()))

    @app.delete("/v1/holds/{name}", dependencies=[needs("hold")], status_code=204, response_class=Response)
    async def unhold(name: str, caller: Who) -> Response:
        """End the hold of a service, or of those of a group."""
        return await held(caller, changes.HoldsBody.model_construct(services=[name]), named=False)

    @app.put("/v1/suspension", dependencies=[needs("suspend")], status_code=204, response_class=Response)
    async def suspend(body: SuspendBody, caller: Who) -> Response:
        """Change nothing for a time."""
        seconds = seconds_of(body.duration, "duration")
        return await applied(operations, caller, changes.suspend(seconds, body.reason, moment()))

    @app.delete("/v1/suspension", dependencies=[needs("suspend")], status_code=204, response_class=Response)
    async def unsuspend(caller: Who) -> Response:
        """End a suspension."""
        return await applied(operations, caller, changes.suspend(None, "", moment()))
