"""The route that answers what an operation would change, before anyone carries it out. The page asks it for each of its
dialogs. It makes the same `Change` as the operation itself, and applies it to a copy of the requests."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Annotated, Literal

from fastapi import FastAPI
from fastapi.responses import JSONResponse, Response
from pydantic import BaseModel, Field

from rorg.api import changes
from rorg.api.callers import Requester, Who, needs
from rorg.api.current import Current
from rorg.api.inputs import Body, PutRequest, ServiceName, request_of, seconds_of
from rorg.api.operations import Operations
from rorg.api.permissions import Caller, allow, allow_request, allow_restart
from rorg.core.consequences import Consequences, Effect, consequences
from rorg.core.inputs import Inputs
from rorg.errors import Invalid, Refused, Unconfirmed
from rorg.host.clock import moment
from rorg.model.catalog import HIGHEST_PRIORITY, Catalog
from rorg.store.requests_document import RequestsDocument

Operation = Literal["request", "release", "restart", "hold", "unhold", "suspend", "unsuspend", "retry"]
NAMING = ("request", "restart", "hold", "unhold", "retry")
"""Operations that name services."""
Make = Callable[[bool], changes.Change]
"""Makes the change of an operation, with or without force. Raises Unconfirmed without force if it needs that."""


class PreviewBody(Body):
    """An operation that is not carried out."""

    operation: Operation
    services: Annotated[list[ServiceName], Field(max_length=300)] = Field(
        default=[], description="Services and groups; none for `release`, `suspend` and `unsuspend`."
    )
    id: Annotated[str, Field(max_length=64)] = Field(default="preview", description="Of the request.")
    priority: Annotated[int, Field(ge=0, le=HIGHEST_PRIORITY)] | None = None
    duration: Annotated[str, Field(max_length=20)] = Field(
        default="10m", description="Of `hold` and `suspend`, such as 10m."
    )


class PreemptedView(BaseModel):
    """A service that something wants, and that would have to wait for others."""

    service: str
    by: list[str] = Field(
        description="Active services that have what it waits for; empty if a hold, pressure or the budget keeps it out."
    )
    reason: str


class WaitView(BaseModel):
    """Something that would not be done at once."""

    service: str
    reason: str
    code: str = Field(description="As of the waitings of a plan.")


class PreviewView(BaseModel):
    """What an operation would change. What stays as it is is left out: empty lists mean that nothing changes now."""

    starts: list[str]
    resumes: list[str]
    pauses: list[str]
    stops: list[str]
    restarts: list[str]
    wanted: list[str] = Field(description="Services that nothing wants now, and that something would want.")
    unwanted: list[str] = Field(description="Services that nothing would want any more. They idle as they declare.")
    preempted: list[PreemptedView]
    waits: list[WaitView]
    interlocked: list[str] = Field(description="Services of these whose interlock has to allow it first.")
    confirm: list[str] = Field(description="Services for which it needs `force`, as in a refusal.")
    confirm_reason: str


def add_previewing(app: FastAPI, operations: Operations) -> None:
    """Adds the route."""
    deciding = asyncio.Lock()
    """Held during an answer: it costs as much as some passes over all services, so one at a time."""

    @app.post("/v1/preview", dependencies=[needs("read")], response_model=PreviewView)
    async def preview(body: PreviewBody, caller: Who, requester: Requester = None) -> Response:
        """What an operation would change now, by the planner itself: rorg decides with it and without it, and answers
        with the difference. Nothing is changed. Who may not carry it out may not ask either, and it is refused for the
        same reasons. `confirm` are the services for which it needs `force`."""
        key = requester or caller.requester, body.id
        allow_operation(caller, body, key[0], operations.catalog)
        async with deciding:
            make = _making(operations.current, body, key)
            why, confirm = "", tuple[str, ...]()
            try:
                change = make(False)
            except Unconfirmed as error:
                why, confirm = error.why, tuple(error.services)
                change = make(True)
            found = await asyncio.to_thread(consequences, *_inputs(operations, change))
        return JSONResponse(view(found, why, confirm))


def allow_operation(caller: Caller, body: PreviewBody, requester: str, catalog: Catalog) -> None:
    """Raises Forbidden unless the caller may carry the operation out."""
    match body.operation:
        case "request":
            allow_request(caller, requester, tuple(body.services), catalog, body.priority)
        case "release":
            allow_request(caller, requester, (), catalog)
        case "restart":
            allow(caller, "restart")
            for name in body.services:
                allow_restart(caller, name, catalog)
        case "hold" | "unhold":
            allow(caller, "hold")
        case "suspend" | "unsuspend":
            allow(caller, "suspend")
        case "retry":
            allow(caller, "retry")


def _making(current: Current, body: PreviewBody, key: tuple[str, str]) -> Make:
    """Return what makes the change of an operation. Raises Invalid if it names no service and must."""
    names, now = body.services, moment()
    if body.operation in NAMING and not names:
        raise Invalid(f"preview a {body.operation}", "services: none is named", "the name of a service")
    if body.operation == "restart" and len(names) > 1:
        raise Invalid("preview a restart", "services: several are named", "one service or group at a time")
    holds = changes.HoldsBody.model_construct(services=names, duration=body.duration)
    makers: Mapping[str, Make] = {
        "request": lambda _: changes.put_request(
            current, request_of(key[1], key[0], PutRequest(services=names, priority=body.priority))
        ),
        "release": lambda force: changes.release(key, None if force else current),
        "restart": lambda force: changes.restart(current, names[0], force, time.time()),
        "hold": lambda force: changes.hold(current, holds.model_copy(update={"force": force}), now),
        "unhold": lambda _: changes.hold(current, holds.model_copy(update={"duration": None}), now),
        "suspend": lambda _: changes.suspend(seconds_of(body.duration, "duration"), "", now),
        "unsuspend": lambda _: changes.suspend(None, "", now),
        "retry": lambda force: changes.retry(current, changes.RetryBody(services=names, force=force), now),
    }
    return makers[body.operation]


def _inputs(operations: Operations, change: changes.Change) -> tuple[Inputs, Inputs]:
    """What a pass would read now, and after a change of the requests file. Raises Refused as the change itself, and
    while the robot is taken down."""
    asked, inputs = operations.committer.file.now(), operations.inputs_now()
    if asked.down:
        raise Refused("preview a change", "the robot is taken down", "`rorg up` first")
    return _with(inputs, asked), _with(inputs, change.edit(asked))


def _with(inputs: Inputs, asked: RequestsDocument) -> Inputs:
    """The inputs with this content of the requests file."""
    return replace(
        inputs,
        requests=asked.requests,
        restarts=asked.restarts,
        retries=asked.retries,
        holds=asked.holds,
        suspended=asked.suspended,
        confirmed=asked.removals,
    )


def view(found: Consequences, why: str, confirm: tuple[str, ...]) -> dict[str, object]:
    """The answer, as PreviewView."""
    return {
        "starts": found.of(Effect.START),
        "resumes": found.of(Effect.RESUME),
        "pauses": found.of(Effect.PAUSE),
        "stops": found.of(Effect.STOP),
        "restarts": found.of(Effect.RESTART),
        "wanted": list(found.wanted),
        "unwanted": list(found.unwanted),
        "preempted": [{"service": p.service, "by": list(p.by), "reason": p.reason} for p in found.preempted],
        "waits": [{"service": w.service, "reason": w.reason, "code": w.code} for w in found.waits],
        "interlocked": list(found.interlocked),
        "confirm": list(confirm),
        "confirm_reason": why,
    }
