"""The journal through the API."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import AsyncGenerator, Callable, Iterable, Mapping
from dataclasses import replace
from typing import Annotated, Any

from fastapi import FastAPI, Query, Request
from fastapi.responses import Response, StreamingResponse
from pydantic import BaseModel
from starlette.types import Receive, Scope, Send

from rorg.api.callers import Who, needs, still
from rorg.api.inputs import moment
from rorg.api.operations import Operations
from rorg.api.permissions import allow_request
from rorg.api.request_routes import gone
from rorg.api.status_models import EventView
from rorg.errors import Busy, Forbidden
from rorg.history.journal import Filter, Journal
from rorg.model.catalog import Catalog
from rorg.model.catalog import Request as Asked
from rorg.model.graph import closure

SLICE = 100
"""Lines that are written at a time: no more are kept for a slow reader."""

When = Annotated[str | None, Query(max_length=64, description="10m (ago), or a time in RFC 3339.")]
Reading = Callable[[asyncio.Future[None]], AsyncGenerator[bytes, None]]
"""Writes pieces until the future says that the caller has hung up."""


class Lines(StreamingResponse):
    """Lines of JSON, until there are no more or the caller hangs up. The task of the call writes them, so that their
    cost is charged to the caller."""

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
    """The arguments of a route that answers with Lines, each one like the model."""
    return {
        "response_class": Lines,
        "responses": {200: {"model": model, "description": "Lines of JSON, each one like this."}},
        "openapi_extra": {"responses": {"200": {"content": {Lines.media_type: {"schema": {"type": "object"}}}}}},
    }


def add_events(app: FastAPI, operations: Operations) -> None:
    """Adds the route."""

    @app.get("/v1/events", dependencies=[needs("events")], **answering_lines(EventView))
    async def events(
        request: Request,
        caller: Who,
        *,
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
        """The journal as lines of JSON, each with a number `seq`: give the last one as cursor to continue from there.
        Without a cursor, the last `tail` lines (with `since` and no `tail`, all from then on), and new ones when
        following. `mine`: only lines about requests of the caller (or of `requester`) and what they name, such as
        `lost`; a service sees no others."""
        journal, now = operations.journal, time.time()
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
            return _lines(operations, replace(meant, after=place), follow, whose, allowed, hangup)

        return Lines(lines, headers={"rorg-cursor": str(place)})


def _begin(journal: Journal, meant: Filter, tail: int) -> int:
    """The number just before the last `tail` of the chosen entries; before all of those since a time, without
    `tail`."""
    if meant.since and not tail:
        return 0
    if meant == Filter():
        return max(0, journal.last - tail)
    last = journal.last
    entries = journal.select(meant, tail, newest=True) if tail else []
    return entries[0]["seq"] - 1 if entries else last


async def _lines(
    operations: Operations,
    meant: Filter,
    follow: bool,
    whose: str,
    allowed: Callable[[], object],
    hangup: asyncio.Future[None],
) -> AsyncGenerator[bytes, None]:
    """Writes lines. `whose`: the requester whose lines alone are shown; empty for all. `allowed` raises Forbidden once
    the caller may not read more, and Busy if that is unknown."""
    journal, written = operations.journal, asyncio.Event()
    end = journal.follow(from_any_thread(written)) if follow else lambda: None
    try:
        while not hangup.done():
            # Both are taken before the journal is read: what is written from here on ends the wait below.
            written.clear()
            turn = operations.next_pass()
            with contextlib.suppress(Busy):
                allowed()
            last = journal.last
            entries = journal.select(meant, SLICE)
            seen = entries[-1]["seq"] if entries else 0
            meant = replace(meant, after=seen if len(entries) == SLICE else max(meant.after, last, seen))
            if entries:
                told = _own(operations, entries, whose) if whose else entries
                if told:
                    yield b"".join(json.dumps(entry).encode() + b"\n" for entry in told)
                await asyncio.sleep(0)  # lets other calls run, and notices a caller who hung up
            elif not follow or operations.ending:
                return
            else:
                await either(written, turn, hangup)
    except Forbidden:
        return  # the next call gets the reason
    finally:
        end()


def from_any_thread(event: asyncio.Event) -> Callable[[], None]:
    """A function that sets an event of this event loop from any thread."""
    loop = asyncio.get_running_loop()

    def tell() -> None:
        with contextlib.suppress(RuntimeError):  # the server has ended
            loop.call_soon_threadsafe(event.set)

    return tell


async def either(one: asyncio.Event, other: asyncio.Event, hangup: asyncio.Future[None]) -> None:
    """Returns when one of the events is set, or the caller hangs up."""
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


def own_events(
    entries: Iterable[Mapping[str, Any]], requester: str, catalog: Catalog, requests: Iterable[Asked]
) -> list[dict[str, Any]]:
    """The entries about the requester, about what its `requests` name, or about what that needs. Of the requests that a
    line names, only the requester's own are kept, by their ids."""
    named = {s for r in requests if r.requester == requester for s in r.services}
    services = {requester, *named, *closure(catalog.services, [m for s in named for m in catalog.members(s)])}
    events = []
    for entry in entries:
        mine = [text.partition("/")[2] for text in entry.get("requests", ()) if text.startswith(f"{requester}/")]
        about = {entry.get("service"), *entry.get("services", ()), *entry.get("shed", ())}
        if mine or about & services:
            events.append({**entry, "requests": mine} if "requests" in entry else dict(entry))
    return events
