"""The requests of meta-services over time. Other services make their own requests."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Iterator
from typing import Any

from rorg.history.database import Database
from rorg.model.catalog import Request
from rorg.model.units import parse_time

NEWEST = "SELECT text FROM asked JOIN asked_text USING (content) WHERE at <= ? ORDER BY number DESC LIMIT 1"
CHANGES = "SELECT at, text FROM asked JOIN asked_text USING (content) WHERE at > ? AND at <= ? ORDER BY number"
ANY = "~"
"""Later than any time, as text."""


class Asked:
    """The table of requests, written by the owner of the file, from one thread."""

    def __init__(self, database: Database) -> None:
        self.database = database
        self._last: str | None = None
        """The text that was written last."""
        self._generation = database.generation

    def note(self, at: str, requests: Iterable[Request]) -> None:
        """Record that meta-services request these from now on (ISO 8601 in UTC)."""
        text = json.dumps([_said(request) for request in requests])
        if self._last is None:
            self._last = next((stored for stored, _ in self.database.read(_read, NEWEST, (ANY,))), "[]")
        if (text, self.database.generation) == (self._last, self._generation):
            return
        self._generation = self.database.generation
        self._last, content = text, hashlib.sha256(text.encode()).hexdigest()[:32]
        self.database.write(
            [
                ("INSERT OR IGNORE INTO asked_text (content, text) VALUES (?, ?)", [(content, text)]),
                ("INSERT INTO asked (at, content) VALUES (?, ?)", [(at, content)]),
            ]
        )

    def at(self, time: str) -> tuple[Request, ...]:
        """Their requests at a time."""
        return next((requests for _, requests in self.database.read(_read, NEWEST, (time,))), ())

    def between(self, begin: str, end: str) -> Iterator[tuple[str, tuple[Request, ...]]]:
        """Their requests at `begin`, then each change up to `end`: (since when, all requests)."""
        yield begin, self.at(begin)
        yield from self.database.read(_change, CHANGES, (begin, end))


def _change(at: str, text: str) -> tuple[str, tuple[Request, ...]]:
    parse_time(at)
    return at, _read(text)[1]


def _read(text: str) -> tuple[str, tuple[Request, ...]]:
    """A text with its requests. Raises ValueError and TypeError if it is damaged."""
    return text, tuple(_request(said) for said in json.loads(text))


def _said(request: Request) -> list[Any]:
    """Without the last renewal, which makes no other request."""
    return [request.requester, request.id, request.services, request.reason, request.priority, request.ttl]


def _request(said: list[Any]) -> Request:
    requester, id, services, reason, priority, ttl = said
    return Request(
        id=str(id),
        requester=str(requester),
        services=tuple(map(str, services)),
        reason=str(reason),
        priority=None if priority is None else int(priority),
        ttl=None if ttl is None else float(ttl),
    )
