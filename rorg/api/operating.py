"""Routes by which people intervene: restart, hold, suspend, confirm removals."""

from __future__ import annotations

import asyncio

from fastapi import FastAPI
from fastapi.responses import Response

from rorg.api.bodies import accepted, duration
from rorg.api.callers import Requester, Who, needs
from rorg.api.models import (
    ConfirmBody,
    Held,
    HoldBody,
)
from rorg.api.operations import Operations


def add_operating(app: FastAPI, operations: Operations) -> None:
    """The routes of restarts, holds, the suspension and removals."""

    @app.post("/v1/services/{name}/restart", dependencies=[needs("restart")], response_model=Held)
    async def restart(  # caller_of reads the requester; here it is for the schema
        name: str,
        caller: Who,
        force: bool = False,
        requester: Requester = None,  # noqa: ARG001
    ) -> Response:
        """Stop and start a service, or each of a group. Drivers only with `force`."""
        generation = await asyncio.wrap_future(operations.restart(caller, name, force))
        return accepted(generation, {"services": list(operations.members(name))})

    @app.put("/v1/holds/{name}", dependencies=[needs("hold")], response_model=Held)
    async def hold(name: str, body: HoldBody, caller: Who) -> Response:
        """Keep a service, or a group's, from being active for a time, whoever requests it."""
        generation = await asyncio.wrap_future(
            operations.hold(caller, name, duration(body.duration, "duration"), body.reason)
        )
        return accepted(generation, {"services": list(operations.members(name))})

    @app.delete("/v1/holds/{name}", dependencies=[needs("hold")], status_code=204, response_class=Response)
    async def unhold(name: str, caller: Who) -> Response:
        return accepted(await asyncio.wrap_future(operations.hold(caller, name, None, "")))

    @app.put("/v1/suspension", dependencies=[needs("suspend")], status_code=204, response_class=Response)
    async def suspend(body: HoldBody, caller: Who) -> Response:
        """Change nothing for a time."""
        return accepted(
            await asyncio.wrap_future(operations.suspend(caller, duration(body.duration, "duration"), body.reason))
        )

    @app.delete("/v1/suspension", dependencies=[needs("suspend")], status_code=204, response_class=Response)
    async def unsuspend(caller: Who) -> Response:
        return accepted(await asyncio.wrap_future(operations.suspend(caller, None, "")))

    @app.put("/v1/removals", dependencies=[needs("removals")], status_code=204, response_class=Response)
    async def confirm(body: ConfirmBody, caller: Who) -> Response:
        """Confirm that what no manifest declares any more is removed, though a request, a need or a group named it."""
        return accepted(await asyncio.wrap_future(operations.confirm(caller, tuple(body.services))))
