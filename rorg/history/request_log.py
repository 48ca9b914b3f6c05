"""The requests of a robot over some time: those at the beginning, and each change.

Requests of meta-services are on record with their times, even if the requests file was edited by hand. Those of other
services are known from the journal.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any, NamedTuple

from rorg.errors import Missing
from rorg.history.journal import Filter, Journal
from rorg.history.meta_requests import Asked

Key = tuple[str, str]
"""(requester, id)."""
ENDING = frozenset({"release", "request-dropped"})
KINDS = frozenset({"request", "down", *ENDING})
SLICE = 500
"""Entries that are read at a time."""


class Asking(NamedTuple):
    """A request that is made, or replaces the previous one; without services, its release. Sorted by time."""

    at: str
    """ISO 8601 in UTC."""
    key: Key
    services: tuple[str, ...]
    reason: str = ""


class _Known(NamedTuple):
    """The requests of services at a time, and the last entry that they were read from."""

    at: str
    seq: int
    held: dict[Key, Asking]


class RequestLog:
    """Reads the journal. Each question continues where the last answer ended, so that nothing is read twice."""

    def __init__(self, journal: Journal) -> None:
        self.journal = journal
        self._known = _Known("", 0, {})

    def between(self, begin: str, end: str) -> dict[str, Any]:
        """Requests from `begin` to `end`, ISO 8601 in UTC, as far as they are on record; those at the beginning come
        first. Raises Missing if nothing of that time is on record."""
        first = next(iter(self.journal.select(Filter(), 1)), None)
        what = f"list what was requested from {begin} to {end}"
        if first is None or begin >= end or first["at"] > end:
            raise Missing(what, "nothing of that time is on record", "`rorg events --since 30d` for what is on record")
        begin, old = max(begin, first["at"]), list[Mapping[str, Any]]()
        people = list(_people(Asked(self.journal.database), begin, end))
        meta = {"developer", *(asking.key[0] for asking in people)}
        services = [asking for asking in self._services(begin, end, old) if asking.key[0] not in meta]
        old = [entry for entry in old if str(entry.get("service", "")) not in meta]
        return {
            "begin": begin,
            "end": end,
            "unknown": sum(entry["at"] >= begin for entry in old),
            "requests": [
                {
                    "at": asking.at,
                    "requester": asking.key[0],
                    "id": asking.key[1],
                    "services": list(asking.services),
                    "reason": asking.reason,
                }
                for asking in _from(begin, sorted([*people, *services]))
            ],
        }

    def _services(self, begin: str, end: str, old: list[Mapping[str, Any]]) -> Iterator[Asking]:
        """Those of all services, also from before `begin`. `old` gets entries of an older rorg, which do not say what
        was requested."""
        known = self._known if self._known.at <= begin else _Known("", 0, {})
        held, seq, passed = dict(known.held), known.seq, False
        yield from held.values()
        for entry in _entries(self.journal, end, seq):
            if entry["at"] > begin and not passed:
                passed, self._known = True, _Known(begin, seq, dict(held))
            seq, at, key = entry["seq"], entry["at"], (str(entry.get("service", "")), str(entry.get("request", "")))
            if entry["kind"] == "down":
                yield from (Asking(at, one, ()) for one in held)
                held.clear()
            elif entry["kind"] in ENDING:
                if held.pop(key, None):
                    yield Asking(at, key, ())
            elif not isinstance(entry.get("requested"), list):
                old.append(entry)
            else:
                asking = Asking(at, key, tuple(map(str, entry["requested"])), str(entry.get("reason", "")))
                if key not in held or held[key].services != asking.services:
                    held[key] = asking
                    yield asking
        if not passed:
            self._known = _Known(begin, seq, held)


def _people(asked: Asked, begin: str, end: str) -> Iterator[Asking]:
    """Those of meta-services."""
    before: Mapping[Key, Asking] = {}
    for at, requests in asked.between(begin, end):
        now = {request.key: Asking(at, request.key, request.services, request.reason) for request in requests}
        yield from (Asking(at, key, ()) for key in before if key not in now)
        yield from (
            asking for key, asking in now.items() if key not in before or before[key].services != asking.services
        )
        before = now


def _entries(journal: Journal, end: str, after: int) -> Iterator[dict[str, Any]]:
    while entries := journal.select(Filter(KINDS, until=end, after=after), SLICE):
        after = entries[-1]["seq"]
        yield from entries


def _from(begin: str, changes: Iterable[Asking]) -> Iterator[Asking]:
    """Changes since `begin`, after the requests at that time."""
    held, late = dict[Key, Asking](), list[Asking]()
    for asking in changes:
        if asking.at > begin:
            late.append(asking)
        elif asking.services:
            held[asking.key] = asking
        else:
            held.pop(asking.key, None)
    yield from (asking._replace(at=begin) for asking in held.values())
    yield from late
