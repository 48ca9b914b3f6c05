"""The logs of services through the API."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import AsyncGenerator, Callable, Iterator, Sequence
from typing import Annotated, Any, NamedTuple

from fastapi import FastAPI, Query, Request
from fastapi.responses import Response

from rorg.api.callers import needs, still
from rorg.api.current import elsewhere
from rorg.api.events import Lines, answering_lines, either, from_any_thread
from rorg.api.limits import MOST_LOGS
from rorg.api.operations import Operations
from rorg.api.status_models import LogView
from rorg.engines.logs import Asked, Entries, Entry, Find, check, gather
from rorg.errors import Busy, Forbidden, Invalid, TooMany
from rorg.model.units import parse_since

Names = Annotated[list[str] | None, Query(max_length=300, description="More services or groups.")]
Cursors = Annotated[
    list[str] | None, Query(max_length=300, description="SERVICE:CURSOR of the last line that is known of a service.")
]


class Readers:
    """Counts the logs that are being read."""

    def __init__(self) -> None:
        self.count = 0

    def check(self, more: int) -> None:
        """Raises TooMany."""
        if self.count + more > MOST_LOGS:
            raise TooMany(
                "read logs", f"{self.count} of {MOST_LOGS} are being read already", "fewer of them, or again later", 5
            )

    @contextlib.contextmanager
    def taken(self, more: int) -> Iterator[None]:
        """Counts some more while the block runs."""
        self.count += more
        try:
            yield
        finally:
            self.count -= more


class Selection(NamedTuple):
    """Which lines to read, as callers write it."""

    follow: bool = False
    tail: int | None = None
    since: str | None = None
    until: str | None = None
    previous: bool = False


def asked_for(services: Sequence[str], lines: Selection, after: Sequence[str] = ()) -> Asked:
    """What to read. Raises Invalid."""
    if lines.follow and (lines.until or lines.previous):
        raise Invalid("follow logs", "earlier lines are asked for", "it without following")
    try:
        since, until = (parse_since(text, time.time()) if text else None for text in (lines.since, lines.until))
    except ValueError as error:
        raise Invalid("read logs", str(error)) from error
    known = {name: cursor for name, _, cursor in (text.partition(":") for text in after)}
    return Asked(tuple(services), lines.follow, lines.tail, since, until, lines.previous, known)


def has_log(named: Sequence[str], asked: Asked, find: Find) -> None:
    """Raises Invalid if what was `named` has nothing to read, and nothing to wait for."""
    what = f"read the logs of {', '.join(named)}"
    if not asked.services:
        raise Invalid(what, "it has no container, and so no log", "another service")
    if not asked.follow and not any(find(name) for name in asked.services):
        raise Invalid(what, "it has no container yet", f"`rorg request {asked.services[0]}`, or -f to wait for it")


def entry_json(entry: Entry) -> dict[str, Any]:
    """As LogView."""
    text = entry.text.decode("utf-8", errors="surrogateescape")
    fields = {"cursor": entry.cursor, "time": entry.time, "text": text, "error": entry.error}
    return {"service": entry.service, **{key: value for key, value in fields.items() if value}}


def add_logs(app: FastAPI, operations: Operations) -> None:
    """Adds the route."""
    readers = Readers()

    @app.get("/v1/services/{name}/logs", dependencies=[needs("logs")], **answering_lines(LogView))
    async def logs(
        request: Request,
        name: str,
        *,
        also: Names = None,
        follow: bool = False,
        tail: Annotated[int | None, Query(ge=0, description="Lines of each service. Default: all.")] = None,
        since: Annotated[str | None, Query(max_length=64, description="10m (ago), or a time in RFC 3339.")] = None,
        until: Annotated[str | None, Query(max_length=64, description="Only earlier lines, as with `since`.")] = None,
        previous: Annotated[bool, Query(description="Only lines from before the current run.")] = False,
        after: Cursors = None,
    ) -> Response:
        """What a service, or each of a group, has printed, merged by time; when following, also new lines, across runs
        and containers, each line once. To continue after a lost connection, give the last cursor of each service. The
        process engine keeps no times: its lines come one service after the other, and `since`, `until` and `previous`
        are refused."""
        named = [name, *(also or ())]
        services = [n for s in dict.fromkeys(named) for n in operations.current.members(s)]
        kept = [n for n in dict.fromkeys(services) if not operations.catalog.services[n].meta]
        for away in (operations.catalog.services[n] for n in kept):
            if away.away:
                raise elsewhere(f"the logs of {away.name}", away, "`--on {machine}`")
        asked = asked_for(kept, Selection(follow, tail, since, until, previous), after or ())
        check(operations.engine, asked)
        if not follow:
            operations.check_engine(f"read the logs of {', '.join(named)}")
        has_log(named, asked, operations.container_of)
        readers.check(len(kept))

        def lines(hangup: asyncio.Future[None]) -> AsyncGenerator[bytes, None]:
            return _lines(operations, asked, readers, lambda: still(request, "logs"), hangup)

        return Lines(lines, headers={"rorg-cursor": "0"})


async def _lines(
    operations: Operations,
    asked: Asked,
    readers: Readers,
    allowed: Callable[[], object],
    hangup: asyncio.Future[None],
) -> AsyncGenerator[bytes, None]:
    written, told = asyncio.Event(), ""
    with readers.taken(len(asked.services)):
        entries: Entries = gather(operations.engine, operations.container_of, asked, from_any_thread(written))
        try:
            while not hangup.done() and not operations.ending:
                # Both are taken before the logs are read: what comes from here on ends the wait below.
                written.clear()
                turn = operations.next_pass()
                with contextlib.suppress(Busy):
                    allowed()
                lines, over = entries.take()
                silence = str(operations.decision.situation.observed.silence or "")
                if silence and silence != told:
                    lines.append(Entry("", error=silence))
                told = silence
                if silence and not asked.follow:
                    over = True
                if lines:
                    yield b"".join(json.dumps(entry_json(entry)).encode() + b"\n" for entry in lines)
                    await asyncio.sleep(0)  # lets other calls run, and notices a caller who hung up
                elif over:
                    return
                else:
                    await either(written, turn, hangup)
        except Forbidden:
            return  # the next call gets the reason
        finally:
            entries.end()
