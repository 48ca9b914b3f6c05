"""The journal through the API."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator, Callable
from typing import Annotated, Any

from fastapi import FastAPI, Query, Request
from fastapi.responses import Response, StreamingResponse

from rorg.api.callers import Who, needs, still
from rorg.api.operations import Operations
from rorg.api.own_events import own_events
from rorg.api.permissions import allow_request
from rorg.api.status_models import EventView
from rorg.errors import Busy, Forbidden

SLICE = 100
"""Lines that are written at once: no more are kept for who reads slowly."""


class Lines(StreamingResponse):
    """Lines of JSON, as long as there are any."""

    media_type = "application/x-ndjson"


def add_events(app: FastAPI, operations: Operations, changed: Callable[[], asyncio.Event]) -> None:
    """The route."""

    @app.get(
        "/v1/events",
        dependencies=[needs("events")],
        response_class=Lines,
        responses={200: {"model": EventView, "description": "Lines of JSON, each one like this."}},
        openapi_extra={"responses": {"200": {"content": {Lines.media_type: {"schema": {"type": "object"}}}}}},
    )
    async def events(
        request: Request,
        caller: Who,
        cursor: Annotated[int | None, Query(ge=0)] = None,
        follow: bool = False,
        tail: Annotated[int, Query(ge=0, le=10_000)] = 0,
        mine: bool = False,
        requester: Annotated[str | None, Query(max_length=64)] = None,
    ) -> Response:
        """The journal as lines of JSON, each with a number `seq`: ask again with the last one as cursor to go on from
        there. Without a cursor, the last `tail` lines, and what comes when following. `mine`: only lines about requests
        of the caller (or of `requester`) and what they name, such as `lost`; a service sees no others."""
        journal = operations.loop.recorder.journal
        place = max(0, journal.last - tail) if cursor is None else cursor
        whose = ""
        if mine or requester or caller.kind == "service":
            whose = requester or caller.requester
            allow_request(caller, whose, (), operations.catalog)
        lines = _lines(operations, place, follow, whose, changed, lambda: still(request, "events"))
        return Lines(lines, headers={"rorg-cursor": str(place)})


async def _lines(
    operations: Operations,
    at: int,
    follow: bool,
    whose: str,
    changed: Callable[[], asyncio.Event],
    allowed: Callable[[], object],
) -> AsyncIterator[bytes]:
    """`whose`: the requester whose lines alone are told; empty for all lines. `allowed` raises Forbidden once the
    caller may not hear more, and Busy where that is not known."""
    journal, written = operations.loop.recorder.journal, asyncio.Event()
    end = journal.follow(_from_any_thread(written)) if follow else lambda: None
    try:
        while True:
            # Both are looked at before the journal is read: what is written from here on wakes the wait below.
            written.clear()
            turn = changed()
            with contextlib.suppress(Busy):
                allowed()
            found = journal.after(at, SLICE)
            if found:
                at = found[-1]["seq"]
                told = _own(operations, found, whose) if whose else found
                if told:
                    yield b"".join(json.dumps(entry).encode() + b"\n" for entry in told)
            elif not follow or operations.ending:
                return
            else:
                await _either(written, turn)
    except Forbidden:
        return  # asked again, it is told why
    finally:
        end()


def _from_any_thread(event: asyncio.Event) -> Callable[[], None]:
    loop = asyncio.get_running_loop()

    def tell() -> None:
        with contextlib.suppress(RuntimeError):  # the server has ended
            loop.call_soon_threadsafe(event.set)

    return tell


async def _either(*events: asyncio.Event) -> None:
    waits = [asyncio.ensure_future(event.wait()) for event in events]
    try:
        await asyncio.wait(waits, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for wait in waits:
            wait.cancel()


def _own(operations: Operations, entries: list[dict[str, Any]], whose: str) -> list[dict[str, Any]]:
    try:
        decision = operations.decision
    except Busy:
        return []
    return own_events(entries, whose, operations.catalog, (*operations.catalog.requests, *decision.settled.requests))
