"""Limits the history by age, by number, and by the size of the file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rorg.history.database import Change, Database
from rorg.history.journal import named_in
from rorg.history.usage import FOLD, SLOT

BATCH = 50
"""Entries that are removed at a time: a writer waits for no more."""
MOST_BYTES = 256 << 20
"""Of the file. Above it, the oldest entries that are not of people go, except for the last LEAST."""
LEAST = 1000
REVISIONS = (
    "DELETE FROM revision WHERE (at < ? OR number <= (SELECT max(number) FROM revision) - ?) AND number NOT IN"
    " (SELECT max(number) FROM revision UNION SELECT max(number) FROM revision WHERE standing = 'good'"
    " UNION SELECT max(number) FROM revision WHERE standing <> 'refused')"
)
"""Removes revisions except the last ones of each sort: the one in force, and the one that a rollback returns to."""
UNUSED_MADE = "DELETE FROM made WHERE last < (SELECT min(number) FROM revision)"
UNUSED_VERDICTS = "DELETE FROM verdict WHERE (service, edition) NOT IN (SELECT service, edition FROM made)"
UNUSED_SPECS = "DELETE FROM spec WHERE digest NOT IN (SELECT digest FROM made)"
REQUESTS = (
    "DELETE FROM asked WHERE (at < ? OR number <= (SELECT max(number) FROM asked) - ?)"
    " AND number < (SELECT max(number) FROM asked)"
)
"""Removes requests except the last ones."""
UNUSED_TEXTS = "DELETE FROM asked_text WHERE content NOT IN (SELECT content FROM asked)"
USAGE = "DELETE FROM usage WHERE hour < ? OR hour <= (SELECT hour FROM usage ORDER BY hour DESC LIMIT 1 OFFSET ?)"
"""Removes whole minutes, tens of minutes or hours."""


@dataclass(frozen=True, slots=True)
class Retention:
    """How much is kept. The last entry, and the revisions that were good or in force last, always are."""

    days: float = 400.0
    events: int = 100_000
    people: int = 20_000
    """Entries of what people did. They are counted separately, so that a busy service does not displace them."""
    revisions: int = 1000
    requests: int = 10_000
    """States of the requests file."""
    usage: int = 100_000
    """Minutes, and tens of minutes, of runs with measured use."""


def trim(database: Database, retention: Retention, oldest: str, rest: Callable[[], object]) -> None:
    """Remove what need not be kept. `oldest`: the time (ISO 8601 in UTC) before which nothing is kept; `rest()` is
    called between two batches, so that others can write."""
    for person, most in ((0, retention.events), (1, retention.people)):
        excess = _number(database, person) - most
        while gone := [row for n, row in enumerate(_oldest(database, person)) if n < excess or row[1] < oldest]:
            if not database.write(_without(gone), keep=False):
                return
            excess -= len(gone)
            rest()
    spare = _number(database, 0) - LEAST
    while spare > 0 and _size(database) > MOST_BYTES and (gone := _oldest(database, 0)[:spare]):
        if not database.write(_without(gone), keep=False):
            return
        spare -= len(gone)
        rest()
    revisions, requests = (oldest, retention.revisions), (oldest, retention.requests)
    unused = [(sql, [()]) for sql in (UNUSED_MADE, UNUSED_SPECS, UNUSED_VERDICTS)]
    database.write([(REVISIONS, [revisions]), *unused], keep=False)
    database.write([(REQUESTS, [requests]), (UNUSED_TEXTS, [()])], keep=False)
    database.write([*((sql, [()]) for sql in FOLD), (USAGE, [(oldest[:SLOT], retention.usage)])], keep=False)


def _number(database: Database, person: int) -> int:
    """The number of entries, of people or not."""
    people = "(SELECT count(*) FROM entry WHERE person)"
    sql = f"SELECT {people if person else f'(SELECT count(*) FROM entry) - {people}'}"
    return next((number for (number,) in database.rows(sql)), 0)


def _oldest(database: Database, person: int) -> list[tuple[Any, ...]]:
    """Number, time and rest of the oldest entries, of people or not, but never the last entry."""
    which = f"{'' if person else 'NOT '}person AND seq < (SELECT max(seq) FROM entry)"
    return database.rows(f"SELECT seq, at, more FROM entry WHERE {which} ORDER BY seq LIMIT {BATCH}")


def _size(database: Database) -> int:
    """Bytes of the file that are used."""
    used = "(SELECT page_count FROM pragma_page_count) - (SELECT freelist_count FROM pragma_freelist_count)"
    return next((size for (size,) in database.rows(f"SELECT ({used}) * page_size FROM pragma_page_size")), 0)


def _without(gone: list[tuple[Any, ...]]) -> Change:
    about = [(name, seq) for seq, _, more in gone for name in named_in(more)]
    return [
        ("DELETE FROM entry WHERE seq = ?", [(seq,) for seq, _, _ in gone]),
        ("DELETE FROM about WHERE service = ? AND seq = ?", about),
    ]
