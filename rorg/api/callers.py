"""What all routes share: who calls, whether the table of permissions allows it, and the answer to a change."""

from __future__ import annotations

import asyncio
from typing import Annotated, Any

from fastapi import Depends, Path, Query, Request
from fastapi.responses import JSONResponse, Response

from rorg.api.changes import Change
from rorg.api.generations import GENERATION
from rorg.api.operations import Operations
from rorg.api.permissions import Caller, acting, allow, allow_call, certified

Id = Annotated[str, Path(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.:-]{0,63}$")]
Requester = Annotated[str | None, Query(description="In whose name; by default the caller's own.")]


def caller_of(request: Request) -> Caller:
    """The caller behind the connection, as the server found out; or the one for whom it acts. Raises Forbidden if the
    manifests do not allow it now."""
    caller: Caller = getattr(request.state, "caller", Caller())
    if caller.certificate:
        return certified(caller, request.app.state.operations.machines.catalog)
    if caller.kind != "service":
        return caller
    catalog = request.app.state.operations.catalog
    allow_call(caller, catalog)
    requester = request.query_params.get("requester")
    return caller if requester in (None, caller.service) else acting(caller, requester, catalog)


async def calling(request: Request) -> Caller:
    """The same as a dependency: a coroutine, since FastAPI hands anything else to a thread and back."""
    return caller_of(request)


Who = Annotated[Caller, Depends(calling)]


def still(request: Request, operation: str) -> Caller:
    """Checks the caller of a long answer again. Raises Forbidden if its permission was withdrawn meanwhile."""
    caller = caller_of(request)
    allow(caller, operation)
    return caller


def needs(operation: str) -> Any:
    """The dependency of a route that checks this operation in the table of permissions."""

    async def check(caller: Who) -> None:
        allow(caller, operation)

    check.operation = operation  # type: ignore[attr-defined]
    return Depends(check)


def accepted(generation: int, body: dict[str, Any] | None = None) -> Response:
    """The answer to a change: its generation, with a body if there is one."""
    headers = {GENERATION: str(generation)}
    if body is None:
        return Response(status_code=204, headers=headers)
    return JSONResponse({**body, "generation": generation}, headers=headers)


async def applied(operations: Operations, caller: Caller, change: Change, named: bool = False) -> Response:
    """Applies a change, and answers when it is on the disk; `named`: with the services that it is about."""
    generation = await asyncio.wrap_future(operations.change(caller, change))
    return accepted(generation, {"services": list(change.services)} if named else None)
