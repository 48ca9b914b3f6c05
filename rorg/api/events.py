"""The journal through the API."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import AsyncGenerator, Callable, Mapping
from dataclasses import replace
from typing import Annotated, Any

from fastapi import FastAPI, Query, Request
from fastapi.responses import Response, StreamingResponse
from pydantic import BaseModel
from starlette.types import Receive, Scope, Send

from rorg.api.callers import Who, needs, still
from rorg.api.inputs import moment
from rorg.api.operations import Operations
from rorg.api.own_events import own_events
from rorg.api.permissions import allow_request
from rorg.api.status_models import EventView
from rorg.api.waiting import gone
from rorg.errors import Busy, Forbidden
from rorg.history.journal import Filter, Journal

SLICE = 100
"""Lines that are written at once: no more are kept for who reads slowly."""

When = Annotated[str | None, Query(max_length=64, description="10m (ago), or a time as of RFC 3339.")]
Reading = Callable[[asyncio.Future[None]], AsyncGenerator[bytes, None]]
"""What is written until a future says that nobody listens any more."""


class Lines(StreamingResponse):
    """Lines of JSON, as long as there are any and somebody listens. They are written by the task of the call itself,
    so that what they cost is charged to the caller."""

    media_type = "application/x-ndjson"

    def __init__(self, lines: Reading, status_code: int = 200, headers: Mapping[str, str] | None = None) -> None:
        super().__init__((), status_code, headers)
        self.lines = lines

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:  # noqa: ARG002 - ASGI's
        hangup = asyncio.ensure_future(gone(receive))
        try:
            await send({"type": "http.response.start", "status": self.status_code, "headers": self.raw_headers})
            async with contextlib.aclosing(self.lines(hangup)) as lines:
                async for piece in lines:
                    await send({"type": "http.response.body", "body": piece, "more_body": True})
            await send({"type": "http.response.body", "body": b""})
        finally:
            hangup.cancel()


def answering_lines(model: type[BaseModel]) -> dict[str, Any]:
    """How a route is declared that answers Lines, each one like the model."""
    return {
        "response_class": Lines,
        "responses": {200: {"model": model, "description": "Lines of JSON, each one like this."}},
        "openapi_extra": {"responses": {"200": {"content": {Lines.media_type: {"schema": {"type": "object"}}}}}},
    }


def add_events(app: FastAPI, operations: Operations, changed: Callable[[], asyncio.Event]) -> None:
    """The route."""

    @app.get("/v1/events", dependencies=[needs("events")], **answering_lines(EventView))
    async def events(
        request: Request,
        caller: Who,
        cursor: Annotated[int | None, Query(ge=0)] = None,
        follow: bool = False,
        tail: Annotated[int, Query(ge=0, le=10_000)] = 0,
        mine: bool = False,
        requester: Annotated[str | None, Query(max_length=64)] = None,
        kind: Annotated[list[str] | None, Query(max_length=100, description="Only of these kinds.")] = None,
        service: Annotated[list[str] | None, Query(max_length=300, description="Only about these services.")] = None,
        since: When = None,
        until: When = None,
        text: Annotated[str, Query(max_length=500, description="Only with this in the message, in any case.")] = "",
    ) -> Response:
        """The journal as lines of JSON, each with a number `seq`: ask again with the last one as cursor to go on from
        there. Without a cursor, the last `tail` lines (with `since` and no `tail`, all from then on), and what
        comes when following. `mine`: only lines about requests of the caller (or of `requester`) and what they name,
        such as `lost`; a service sees no others."""
        journal, now = operations.loop.recorder.journal, time.time()
        begin, end = moment(since, "since", now), moment(until, "until", now)
        meant = Filter(frozenset(kind or ()), frozenset(service or ()), begin, end, text)
        place = _begin(journal, meant, tail) if cursor is None else cursor
        whose = ""
        if mine or requester or caller.kind == "service":
            whose = requester or caller.requester
            allow_request(caller, whose, (), operations.catalog)

        def allowed() -> object:
            return still(request, "events")

        def lines(hangup: asyncio.Future[None]) -> AsyncGenerator[bytes, None]:
            return _lines(operations, replace(meant, after=place), follow, whose, changed, allowed, hangup)

        return Lines(lines, headers={"rorg-cursor": str(place)})


def _begin(journal: Journal, meant: Filter, tail: int) -> int:
    """The number after which the last `tail` of the entries that are meant stand; all, of those since a time."""
    if meant.since and not tail:
        return 0
    if meant == Filter():
        return max(0, journal.last - tail)
    last = journal.last
    found = journal.select(meant, tail, newest=True) if tail else []
    return found[0]["seq"] - 1 if found else last


async def _lines(
    operations: Operations,
    meant: Filter,
    follow: bool,
    whose: str,
    changed: Callable[[], asyncio.Event],
    allowed: Callable[[], object],
    hangup: asyncio.Future[None],
) -> AsyncGenerator[bytes, None]:
    """`whose`: the requester whose lines alone are told; empty for all lines. `allowed` raises Forbidden once the
    caller may not hear more, and Busy where that is not known."""
    journal, written = operations.loop.recorder.journal, asyncio.Event()
    end = journal.follow(from_any_thread(written)) if follow else lambda: None
    try:
        while not hangup.done():
            # Both are looked at before the journal is read: what is written from here on wakes the wait below.
            written.clear()
            turn = changed()
            with contextlib.suppress(Busy):
                allowed()
            last = journal.last
            found = journal.select(meant, SLICE)
            seen = found[-1]["seq"] if found else 0
            meant = replace(meant, after=seen if len(found) == SLICE else max(meant.after, last, seen))
            if found:
                told = _own(operations, found, whose) if whose else found
                if told:
                    yield b"".join(json.dumps(entry).encode() + b"\n" for entry in told)
                await asyncio.sleep(0)  # others have their turn, and it is heard that nobody listens any more
            elif not follow or operations.ending:
                return
            else:
                await either(written, turn, hangup)
    except Forbidden:
        return  # asked again, it is told why
    finally:
        end()


def from_any_thread(event: asyncio.Event) -> Callable[[], None]:
    """Sets an event of this loop."""
    loop = asyncio.get_running_loop()

    def tell() -> None:
        with contextlib.suppress(RuntimeError):  # the server has ended
            loop.call_soon_threadsafe(event.set)

    return tell


async def either(one: asyncio.Event, other: asyncio.Event, hangup: asyncio.Future[None]) -> None:
    """Returns when one of them is set, or nobody listens any more."""
    waits: list[asyncio.Future[Any]] = [asyncio.ensure_future(event.wait()) for event in (one, other)]
    try:
        await asyncio.wait([*waits, hangup], return_when=asyncio.FIRST_COMPLETED)
    finally:
        for wait in waits:
            wait.cancel()


def _own(operations: Operations, entries: list[dict[str, Any]], whose: str) -> list[dict[str, Any]]:
    try:
        decision = operations.decision
    except Busy:
        return []
    return own_events(entries, whose, operations.catalog, (*operations.catalog.requests, *decision.settled.requests))
