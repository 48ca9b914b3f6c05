"""The history through the API: revisions of the manifests, timelines of services, and the export of everything."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator, Iterator
from itertools import islice
from typing import Annotated, Any, Literal

from fastapi import FastAPI, Query
from fastapi.responses import Response

from rorg.api.callers import needs
from rorg.api.events import Lines, When, answering_lines
from rorg.api.history_models import (
    Comparison,
    EarlierView,
    MeasuredView,
    RecordView,
    Requested,
    RevisionDetail,
    RevisionView,
    SlotView,
    Timeline,
)
from rorg.api.inputs import moment
from rorg.api.limits import MOST_EXPORTS, MOST_REVISIONS
from rorg.api.operations import Operations
from rorg.api.read_routes import text
from rorg.api.records import ENCODERS
from rorg.errors import TooMany
from rorg.history import queries
from rorg.history.revisions import Revision, Revisions
from rorg.history.usage import MACHINE, UsageTable
from rorg.host.git import commit_of
from rorg.model.units import stamp

SLICE = 200
"""Records that are written at a time."""
DAY = 86400.0


class Protobuf(Lines):
    """Records of `schemas/journal.proto`, each after its length as a varint."""

    media_type = "application/x-protobuf"


def add_history(app: FastAPI, operations: Operations) -> None:
    """Adds the routes."""
    _add_export(app, operations)
    _add_recorded(app, operations)
    history = [needs("history")]

    def named(rev: str) -> Revision:
        return queries.resolve(rev, _revisions(operations), lambda name: commit_of(operations.tree.root, name))

    @app.get("/v1/history", dependencies=history, response_model=list[RevisionView])
    def listed(
        most: Annotated[int, Query(ge=1, le=MOST_REVISIONS)] = 20,
        before: Annotated[int, Query(ge=0, description="Only older ones than this number.")] = 0,
    ) -> Response:
        """The revisions of the manifests that were applied or refused, the newest first."""
        return text(queries.listed(_revisions(operations), most, before))

    @app.get("/v1/history/{a:path}/diff/{b:path}", dependencies=history, response_model=Comparison)
    def compared(a: str, b: str) -> Response:
        """The services that differ between two revisions, with their fields. Revisions are named by number, or as git
        names commits."""
        return text(queries.compared(named(a), named(b)))

    @app.get("/v1/history/{rev:path}", dependencies=history, response_model=RevisionDetail)
    def shown(rev: str) -> Response:
        """Everything about a revision, named by its number, or as git names commits: a hash, a tag, a branch,
        HEAD~2."""
        return text(queries.full(named(rev)))

    @app.get("/v1/timeline/{service}", dependencies=history, response_model=Timeline)
    def timeline(service: str, since: When = None, until: When = None) -> Response:
        """The states of a service over time, with reasons and requesters: of the last day, or `since`. Also for a
        service that is no longer declared; without spans if nothing is on record."""
        now = time.time()
        begin, end = moment(since, "since", now) or stamp(now - DAY), moment(until, "until", now) or stamp(now)
        return text(queries.timeline(operations.journal, service, begin, end))


def _add_recorded(app: FastAPI, operations: Operations) -> None:
    @app.get("/v1/rollback", dependencies=[needs("history")], response_model=list[EarlierView])
    def earlier(
        service: Annotated[str, Query(description="A rollback of this service alone.")] = "",
    ) -> Response:
        """The revisions that a rollback may return to, the newest first: those from before the manifests in force,
        each with the doubt about it."""
        return text(queries.earlier(operations.recorder.history, service))

    @app.get("/v1/requested", dependencies=[needs("history")], response_model=Requested)
    def requested(since: When = None, until: When = None) -> Response:
        """The requests of the last day, or `since`: those in force at the begin, and each request and release after
        that. Standing requests of manifests are left out."""
        now = time.time()
        begin, end = moment(since, "since", now) or stamp(now - DAY), moment(until, "until", now) or stamp(now)
        return text(operations.request_log.between(begin, end))

    @app.get("/v1/measured", dependencies=[needs("history")], response_model=list[MeasuredView])
    def measured(since: When = None) -> Response:
        """What services used while they ran, in the last day or `since` (counted from the full minute)."""
        now = time.time()
        begin = moment(since, "since", now) or stamp(now - DAY)
        return text(UsageTable(operations.recorder.history).since(begin))

    @app.get("/v1/measured/slots", dependencies=[needs("history")], response_model=list[SlotView])
    def slots(
        since: When = None,
        until: When = None,
        services: Annotated[bool, Query(description="Also each service, beside the machine.")] = True,
    ) -> Response:
        """What the machine and its services used over time, in the last day or `since`, in order of time."""
        now = time.time()
        begin, end = moment(since, "since", now) or stamp(now - DAY), moment(until, "until", now) or stamp(now)
        used = UsageTable(operations.recorder.history).slots(begin, end)
        return text([slot._asdict() for slot in used if services or slot.service == MACHINE])


def _add_export(app: FastAPI, operations: Operations) -> None:
    under_way: set[object] = set()

    @app.get("/v1/history/export", dependencies=[needs("history")], **answering_lines(RecordView))
    async def export(format: Literal["jsonl", "protobuf"] = "jsonl") -> Response:
        """Everything on record, revisions first: as lines of JSON, or as the messages of `schemas/journal.proto`, each
        after its length (application/x-protobuf)."""
        if len(under_way) >= MOST_EXPORTS:
            raise TooMany("export the history", f"{MOST_EXPORTS} exports are being written already", "again later", 5)
        records, encode = queries.records(operations.journal, _revisions(operations)), ENCODERS[format]

        async def pieces(hangup: asyncio.Future[None]) -> AsyncGenerator[bytes, None]:
            token = object()
            under_way.add(token)
            try:
                while not hangup.done() and not operations.ending:
                    piece = await asyncio.to_thread(_piece, records, encode)
                    if not piece:
                        return
                    yield piece
            finally:
                under_way.discard(token)

        return (Protobuf if format == "protobuf" else Lines)(pieces, headers={"rorg-cursor": "0"})


def _revisions(operations: Operations) -> Revisions:
    return Revisions(operations.recorder.history)


def _piece(records: Iterator[dict[str, Any]], encode: Any) -> bytes:
    return b"".join(map(encode, islice(records, SLICE)))
