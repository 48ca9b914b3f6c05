"""What of the history is kept: bounded by age, by number, and by the size of the file."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from dataclasses import dataclass

from rorg.history.database import Database
from rorg.history.journal import named_in

BATCH = 200
"""Entries that are taken out at once: whoever writes waits for no more."""
MOST_BYTES = 256 << 20
"""Of the file. Above it the oldest entries go that are not people's, but for the last LEAST."""
LEAST = 1000


@dataclass(frozen=True, slots=True)
class Retention:
    """How much is kept. The last entry, and what was good or in force last, always are."""

    days: float = 400.0
    events: int = 100_000
    people: int = 20_000
    """Entries of what people did, which are counted apart: no service that does much pushes them out."""
    revisions: int = 1000
    requests: int = 10_000
    """States of the requests file."""


def trim(database: Database, retention: Retention, oldest: str) -> None:
    """Takes out what need not be kept. `oldest`: the time (ISO 8601 in UTC) before which nothing is."""
    for person, most in ((0, retention.events), (1, retention.people)):
        while _too_many(database, person, most, oldest) and database.write(_without(person, most, oldest), keep=False):
            pass
    while _too_large(database) and database.write(_without(0, LEAST, ""), keep=False):
        pass
    database.write(lambda connection: _trim_revisions(connection, retention.revisions, oldest), keep=False)
    database.write(lambda connection: _trim_requests(connection, retention.requests, oldest), keep=False)


def _number(person: int) -> str:
    """For SQL: the number of entries of a sort."""
    people = "(SELECT count(*) FROM entry WHERE person)"
    return people if person else f"((SELECT count(*) FROM entry) - {people})"


def _sort(person: int) -> str:
    """For SQL: the entries of a sort that may go."""
    return f"FROM entry WHERE {'' if person else 'NOT '}person AND seq < (SELECT max(seq) FROM entry) ORDER BY seq"


def _too_many(database: Database, person: int, most: int, oldest: str) -> bool:
    rows = database.rows(f"SELECT {_number(person)}, (SELECT at {_sort(person)} LIMIT 1)")
    return any(count > most or (at is not None and at < oldest) for count, at in rows)


def _too_large(database: Database) -> bool:
    used = "(SELECT page_count FROM pragma_page_count) - (SELECT freelist_count FROM pragma_freelist_count)"
    rows = database.rows(f"SELECT ({used}) * page_size, {_number(0)} FROM pragma_page_size")
    return any(size > MOST_BYTES and count > LEAST for size, count in rows)


def _without(person: int, most: int, oldest: str) -> Callable[[sqlite3.Connection], None]:
    """Takes the oldest entries of a sort out, so many as must go and no more than BATCH."""

    def change(connection: sqlite3.Connection) -> None:
        excess = connection.execute(f"SELECT {_number(person)}").fetchone()[0] - most
        rows = connection.execute(f"SELECT seq, at, more {_sort(person)} LIMIT {BATCH}").fetchall()
        gone = [row for index, row in enumerate(rows) if index < excess or row[1] < oldest]
        connection.executemany("DELETE FROM entry WHERE seq = ?", [(seq,) for seq, _, _ in gone])
        about = [(name, seq) for seq, _, more in gone for name in named_in(more)]
        connection.executemany("DELETE FROM about WHERE service = ? AND seq = ?", about)

    return change


def _trim_revisions(connection: sqlite3.Connection, most: int, oldest: str) -> None:
    """But the last ones of each sort: what is in force, and what a rollback goes back to."""
    connection.execute(
        "DELETE FROM revision WHERE (at < ? OR number <= (SELECT max(number) FROM revision) - ?) AND number NOT IN"
        " (SELECT max(number) FROM revision UNION SELECT max(number) FROM revision WHERE standing = 'good'"
        " UNION SELECT max(number) FROM revision WHERE standing <> 'refused')",
        (oldest, most),
    )
    connection.execute("DELETE FROM made WHERE last < (SELECT min(number) FROM revision)")
    connection.execute("DELETE FROM spec WHERE digest NOT IN (SELECT digest FROM made)")


def _trim_requests(connection: sqlite3.Connection, most: int, oldest: str) -> None:
    """But the last one."""
    connection.execute(
        "DELETE FROM asked WHERE (at < ? OR number <= (SELECT max(number) FROM asked) - ?)"
        " AND number < (SELECT max(number) FROM asked)",
        (oldest, most),
    )
    connection.execute("DELETE FROM asked_text WHERE content NOT IN (SELECT content FROM asked)")
