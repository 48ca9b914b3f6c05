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
from rorg.model.catalog import Request

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


def requested(journal: Journal, begin: str, end: str) -> dict[str, Any]:
    """Requests from `begin` to `end`, ISO 8601 in UTC, as far as they are on record; those at the beginning come first.
    Raises Missing if nothing of that time is on record."""
    first = next(iter(journal.select(Filter(), 1)), None)
    what = f"list what was requested from {begin} to {end}"
    if first is None or begin >= end or first["at"] > end:
        raise Missing(what, "nothing of that time is on record", "`rorg events --since 30d` for what is on record")
    begin, old = max(begin, first["at"]), list[Mapping[str, Any]]()
    people = list(_people(Asked(journal.database), begin, end))
    meta = {"developer", *(asking.key[0] for asking in people)}
    changes = sorted([*people, *_services(journal, end, meta, old)])
    return {
        "begin": begin,
        "end": end,
        "unknown": sum(entry["at"] >= begin for entry in old),
        "requests": [
            {"at": asking.at, "requester": asking.key[0], "id": asking.key[1], "services": list(asking.services)}
            for asking in _from(begin, changes)
        ],
    }


def _people(asked: Asked, begin: str, end: str) -> Iterator[Asking]:
    """Those of meta-services."""
    before: Mapping[Key, tuple[str, ...]] = {}
    for at, requests in asked.between(begin, end):
        now = _services_of(requests)
        yield from (Asking(at, key, ()) for key in before if key not in now)
        yield from (Asking(at, key, services) for key, services in now.items() if before.get(key) != services)
        before = now


def _services_of(requests: Iterable[Request]) -> dict[Key, tuple[str, ...]]:
    return {request.key: request.services for request in requests}


def _services(journal: Journal, end: str, meta: set[str], old: list[Mapping[str, Any]]) -> Iterator[Asking]:
    """Those of all other services. `old` gets entries of an older rorg, which do not say what was requested."""
    held = dict[Key, tuple[str, ...]]()
    for entry in _entries(journal, end):
        at, key = entry["at"], (str(entry.get("service", "")), str(entry.get("request", "")))
        if entry["kind"] == "down":
            yield from (Asking(at, one, ()) for one in held)
            held.clear()
        elif key[0] in meta:
            continue
        elif entry["kind"] in ENDING:
            if held.pop(key, None):
                yield Asking(at, key, ())
        elif not isinstance(entry.get("requested"), list):
            old.append(entry)
        elif held.get(key) != (services := tuple(map(str, entry["requested"]))):
            held[key] = services
            yield Asking(at, key, services)


def _entries(journal: Journal, end: str) -> Iterator[dict[str, Any]]:
    after = 0
    while entries := journal.select(Filter(KINDS, until=end, after=after), SLICE):
        after = entries[-1]["seq"]
        yield from entries


def _from(begin: str, changes: Iterable[Asking]) -> Iterator[Asking]:
    """Changes since `begin`, after the requests at that time."""
    held, late = dict[Key, tuple[str, ...]](), list[Asking]()
    for asking in changes:
        if asking.at > begin:
            late.append(asking)
        elif asking.services:
            held[asking.key] = asking.services
        else:
            held.pop(asking.key, None)
    yield from (Asking(begin, key, services) for key, services in held.items())
    yield from late
