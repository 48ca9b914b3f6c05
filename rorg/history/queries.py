"""Answers questions about the history: for the API of the running rorg, and for commands that read its database."""

from __future__ import annotations

import json
import re
from bisect import bisect_right
from collections.abc import Callable, Iterator
from dataclasses import asdict
from functools import cache
from operator import itemgetter
from typing import Any

from rorg.core.changed_fields import Change, changes_between
from rorg.core.digest import declared_of
from rorg.core.masking import masked
from rorg.errors import Missing
from rorg.history.database import Database
from rorg.history.evidence import earlier_revisions, earlier_states
from rorg.history.journal import Filter, Journal
from rorg.history.revisions import FIELDS, Made, Revision, Revisions, parse
from rorg.history.timeline import Author, spans

COMMIT = re.compile(r"[0-9a-f]{7,40}")
SLICE = 500
"""Entries that are read at a time."""
MOST_SPANS = 10_000
"""Entries that a timeline is made from: the newest ones."""
MOST_ASKED = 2000
"""Entries about one request."""
TELLING = frozenset({"state", "found", "done", "crashed", "restart", "hold"})
"""Kinds of entries that a timeline is made from."""


def resolve(text: str, revisions: Revisions, commit_of: Callable[[str], str]) -> Revision:
    """The revision of a name, with its services. `commit_of` returns git's commit of a name, or an empty text. Raises
    Missing."""
    revision = parse(text, revisions)
    if isinstance(revision, Revision):
        return revision
    commit = commit_of(text) or (text if COMMIT.fullmatch(text) else "")
    known = revisions.of_commit(commit) if commit else None
    if known is None:
        why = f"nothing of {commit[:12]} was ever applied here" if commit else "no revision has this number or commit"
        raise Missing(f"find the revision '{text}'", why, "`rorg history` for the list")
    return known


def listed(revisions: Revisions, most: int, before: int = 0) -> list[dict[str, Any]]:
    """The newest revisions first, without their services and plans."""
    return [brief(revision) for revision in revisions.list(most, before)]


def earlier(database: Database, service: str = "") -> list[dict[str, Any]]:
    """The revisions that a rollback, of one service or of all, may return to, the newest first, each with the doubt
    about it."""
    return [asdict(one) for one in (earlier_states(database, service) if service else earlier_revisions(database))]


def brief(revision: Revision) -> dict[str, Any]:
    """A revision as it is in a list."""
    fields = {name: getattr(revision, name) for name in FIELDS if name != "plan"}
    return {**fields, "errors": list(revision.errors)}


def full(revision: Revision) -> dict[str, Any]:
    """All of a revision; possible secrets are masked."""
    services = {name: _made(made) for name, made in sorted(revision.services.items())}
    return {**brief(revision), "plan": revision.plan, "services": services}


def _made(made: Made) -> dict[str, Any]:
    shown = {name: masked(name, value) for name, value in sorted(declared_of(made.declared).items())}
    return {**asdict(made), "declared": json.dumps(shown)}


def compared(old: Revision, new: Revision) -> dict[str, Any]:
    """The services that differ between two revisions, with the fields."""
    names = sorted({*old.services, *new.services})
    changes = [_change(name, old.services.get(name), new.services.get(name)) for name in names]
    return {"old": brief(old), "new": brief(new), "services": [c for c in changes if c]}


def _change(name: str, old: Made | None, new: Made | None) -> dict[str, Any] | None:
    if old == new:
        return None
    word = "added" if old is None else "removed" if new is None else "changed"
    fields = list(_fields(old, new)) if old and new else []
    if word == "changed" and not fields:
        if old and new and old.edition == new.edition:
            return None  # only the image id has become known
        fields = [Change("probes or mounted files", None, None)]
    return _told(name, word, fields)


def _told(name: str, word: str, fields: list[Change]) -> dict[str, Any]:
    return {"service": name, "change": word, "fields": [field.as_json() for field in fields]}


def _fields(old: Made, new: Made) -> Iterator[Change]:
    yield from changes_between(declared_of(old.declared), declared_of(new.declared))
    if old.image == new.image and old.image_id and new.image_id and old.image_id != new.image_id:
        yield Change("image_id", old.image_id, new.image_id)


def timeline(journal: Journal, service: str, since: str, until: str) -> dict[str, Any]:
    """The states of a service in a time, from ISO 8601 to ISO 8601. Empty if nothing is on record."""
    services = frozenset({service})
    before = journal.select(Filter(kinds=frozenset({"state", "found"}), services=services, until=since), 1, newest=True)
    entries = journal.select(Filter(TELLING, services, since=since, until=until), MOST_SPANS, newest=True)
    begin = entries[0]["at"] if len(entries) == MOST_SPANS else since
    known = [*before, *(e for e in entries if not before or e["seq"] > before[0]["seq"])]
    states = spans(service, known, begin, until, _authors(journal, until))
    return {"service": service, "begin": begin, "end": until, "spans": [span.as_json() for span in states]}


def _authors(journal: Journal, end: str) -> Author:
    @cache
    def asked(requester: str, id: str) -> list[dict[str, Any]]:
        meant = Filter(frozenset({"request", "release"}), frozenset({requester}), until=end, text=f"'{id}'")
        return [e for e in journal.select(meant, MOST_ASKED, newest=True) if e.get("request") == id]

    def author(requester: str, id: str, until: str) -> str:
        requests = asked(requester, id)
        before = bisect_right(requests, until, key=itemgetter("at"))
        return str(requests[before - 1].get("author", "")) if before else ""

    return author


def records(journal: Journal, revisions: Revisions) -> Iterator[dict[str, Any]]:
    """Everything on record: revisions, then entries of the journal, each in the order of their numbers."""
    newest = next(iter(revisions.list(1)), None)
    for number in range(1, newest.number + 1 if newest else 1):
        revision = revisions.get(number)
        if revision:
            yield {"revision": full(revision)}
    yield from ({"event": entry} for entry in _entries(journal))


def _entries(journal: Journal) -> Iterator[dict[str, Any]]:
    at, last = 0, journal.last
    while at < last and (entries := journal.after(at, SLICE)):
        at = entries[-1]["seq"]
        yield from entries
