"""Routes by which people intervene: restart, hold, suspend, confirm removals."""

from __future__ import annotations

import asyncio
from typing import Annotated

from fastapi import FastAPI, Query
from fastapi.responses import Response

from rorg.api.bodies import accepted
from rorg.api.body_models import ConfirmBody, DownBody, HoldBody, HoldsBody, RetryBody, SuspendBody
from rorg.api.callers import Requester, Who, needs
from rorg.api.inputs import seconds_of
from rorg.api.models import Held
from rorg.api.operations import Operations
from rorg.api.status_models import GitView


def add_operating(app: FastAPI, operations: Operations) -> None:
    """The routes."""
    _add_holds(app, operations)
    _add_down(app, operations)
    _add_suspension(app, operations)

    @app.post("/v1/services/{name}/restart", dependencies=[needs("restart")], response_model=Held)
    async def restart(  # caller_of reads the requester; here it is for the schema
        name: str,
        caller: Who,
        force: bool = False,
        requester: Requester = None,  # noqa: ARG001
    ) -> Response:
        """Stop and start a service, or each of a group. Where it moves hardware, or others go along, only with `force`:
        the refusal names them in `confirm`."""
        names, change = operations.restart(caller, name, force)
        return accepted(await asyncio.wrap_future(change), {"services": list(names)})

    @app.post("/v1/retries", dependencies=[needs("retry")], response_model=Held)
    async def retry(body: RetryBody, caller: Who) -> Response:
        """Try changes of services again that failed, all of them or none, though nothing of them was changed. Where
        that replaces what moves hardware, or others go along, only with `force`: the refusal names them in
        `confirm`."""
        names, change = operations.retry(caller, body.services, body.force)
        return accepted(await asyncio.wrap_future(change), {"services": list(names)})

    @app.put("/v1/removals", dependencies=[needs("removals")], status_code=204, response_class=Response)
    async def confirm(body: ConfirmBody, caller: Who) -> Response:
        """Confirm that what no manifest declares any more is removed, though a request, a need or a group named it."""
        return accepted(await asyncio.wrap_future(operations.confirm(caller, tuple(body.services))))

    @app.post("/v1/fetch", dependencies=[needs("fetch")], response_model=GitView)
    async def fetch(
        seconds: Annotated[float, Query(ge=0, le=60, description="Wait so long for it.")] = 8.0,
    ) -> Response:
        """Look at the repository that is followed, now. Answers with how that went; refused where none is followed."""
        return accepted(*await asyncio.to_thread(operations.fetch, seconds))


def _add_down(app: FastAPI, operations: Operations) -> None:
    @app.put("/v1/down", dependencies=[needs("down")], status_code=204, response_class=Response)
    async def down(body: DownBody, caller: Who) -> Response:
        """Cease and remove everything, in order, whoever requests it; then rorg ends. The robot stays down until
        somebody runs it again."""
        return accepted(await asyncio.wrap_future(operations.down(caller, body.keep_requests, body.volumes)))

    @app.delete("/v1/down", dependencies=[needs("down")], status_code=204, response_class=Response)
    async def up(caller: Who) -> Response:
        """Bring the robot up that was taken down."""
        return accepted(await asyncio.wrap_future(operations.up(caller)))


def _add_holds(app: FastAPI, operations: Operations) -> None:
    @app.put("/v1/holds/{name}", dependencies=[needs("hold")], response_model=Held)
    async def hold(name: str, body: HoldBody, caller: Who) -> Response:
        """Keep a service, or a group's, from being active for a time, whoever requests it. Where that stops what moves
        hardware, or others with it, only with `force`: the refusal names them in `confirm`."""
        seconds = seconds_of(body.duration, "duration")
        names, change = operations.hold(caller, [name], seconds, body.reason, body.force)
        return accepted(await asyncio.wrap_future(change), {"services": list(names)})

    @app.put("/v1/holds", dependencies=[needs("hold")], response_model=Held)
    async def hold_all(body: HoldsBody, caller: Who) -> Response:
        """Keep services and groups from being active for a time, all of them or none; without a duration that ends.
        `force` as for one of them."""
        seconds = seconds_of(body.duration, "duration")
        names, change = operations.hold(caller, body.services, seconds, body.reason, body.force)
        return accepted(await asyncio.wrap_future(change), {"services": list(names)})

    @app.delete("/v1/holds/{name}", dependencies=[needs("hold")], status_code=204, response_class=Response)
    async def unhold(name: str, caller: Who) -> Response:
        """End the hold of a service, or of a group's."""
        return accepted(await asyncio.wrap_future(operations.hold(caller, [name], None, "")[1]))


def _add_suspension(app: FastAPI, operations: Operations) -> None:
    @app.put("/v1/suspension", dependencies=[needs("suspend")], status_code=204, response_class=Response)
    async def suspend(body: SuspendBody, caller: Who) -> Response:
        """Change nothing for a time."""
        seconds = seconds_of(body.duration, "duration")
        return accepted(await asyncio.wrap_future(operations.suspend(caller, seconds, body.reason)))

    @app.delete("/v1/suspension", dependencies=[needs("suspend")], status_code=204, response_class=Response)
    async def unsuspend(caller: Who) -> Response:
        """End a suspension."""
        return accepted(await asyncio.wrap_future(operations.suspend(caller, None, "")))
