"""The journal: a numbered entry for everything that happened."""

from __future__ import annotations

import json
import threading
import zlib
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rorg.errors import Invalid
from rorg.history.database import Database, reading

RECENT = 2000
"""Entries in memory, for followers, and while the disk refuses them."""
ALL = 1 << 62
COLUMNS = "seq, at, kind, message, person, more, checksum"
ENTRY = f"INSERT OR REPLACE INTO entry ({COLUMNS}) VALUES (?,?,?,?,?,?,?)"
ABOUT = "INSERT OR REPLACE INTO about (service, seq) VALUES (?, ?)"
SLICE = 500
"""Entries that are checked at a time."""
NAMING = ("services", "shed")
"""Fields of an entry that name services, besides `service`."""


@dataclass(frozen=True, slots=True)
class Filter:
    """Selects entries that match all fields that are not empty. Times are ISO 8601 in UTC."""

    kinds: frozenset[str] = frozenset()
    services: frozenset[str] = frozenset()
    """About any of these."""
    since: str = ""
    until: str = ""
    text: str = ""
    """Part of the message, ignoring case."""
    after: int = 0
    """The number is greater."""

    def matches(self, entry: dict[str, Any]) -> bool:
        """Whether an entry in memory matches."""
        return (
            entry["seq"] > self.after
            and (not self.kinds or entry["kind"] in self.kinds)
            and (not self.services or bool(self.services & set(named(entry))))
            and (not self.since or entry["at"] >= self.since)
            and (not self.until or entry["at"] <= self.until)
            and self.text.lower() in entry["message"].lower()
        )

    def condition(self) -> tuple[str, list[Any]]:
        """The same for SQL: a condition on the table `entry`, and its arguments."""
        parts: list[tuple[str, list[Any]]] = [("seq > ?", [self.after])]
        if self.kinds:
            parts.append((f"kind IN ({_marks(self.kinds)})", sorted(self.kinds)))
        if self.services:
            about = f"seq IN (SELECT seq FROM about WHERE service IN ({_marks(self.services)}))"
            parts.append((about, sorted(self.services)))
        if self.since:
            parts.append(("at >= ?", [self.since]))
        if self.until:
            parts.append(("at <= ?", [self.until]))
        if self.text:
            escaped = "".join("\\" + c if c in "%_\\" else c for c in self.text)
            parts.append(("message LIKE ? ESCAPE '\\'", [f"%{escaped}%"]))
        return " AND ".join(sql for sql, _ in parts), [value for _, values in parts for value in values]


class Journal:
    """`seq` numbers entries without gaps as long as they are kept, across restarts of rorg."""

    def __init__(self, database: Database) -> None:
        self.database = database
        self._lock = threading.Lock()
        self._recent: deque[dict[str, Any]] = deque(maxlen=RECENT)
        has_checksums = database.rows("SELECT 1 FROM pragma_table_info('entry') WHERE name = 'checksum'")
        self._columns = COLUMNS if has_checksums else COLUMNS.replace("checksum", "NULL")
        """With NULL for a file that an older rorg wrote."""
        self._seq: int = next((entry["seq"] for entry in self._stored("1 ORDER BY seq DESC LIMIT 1", [])), 0)
        self._followers: list[Callable[[], None]] = []
        self._counts: Counter[str] = Counter()

    def append(self, at: str, kind: str, message: str, person: bool = False, **more: Any) -> None:
        """`at` is ISO 8601 in UTC; `kind` a stable word; `person`: a person did it. A full disk loses the entry, but
        never stops the robot."""
        with self._lock:
            self._seq += 1
            entry = {"seq": self._seq, "at": at, "kind": kind, "message": message, **more}
            self._recent.append(entry)
            self._counts[kind] += 1
            row = (self._seq, at, kind, _sound(message), int(person), json.dumps(more))
            about = [(_sound(name), self._seq) for name in dict.fromkeys(named(entry))]
            self.database.write([(ENTRY, [(*row, checksum(*row))]), (ABOUT, about)])
            followers = tuple(self._followers)
        for tell in followers:
            tell()

    def follow(self, tell: Callable[[], None]) -> Callable[[], None]:
        """Call `tell` after every entry, in the thread that wrote it, until the returned function is called."""
        with self._lock:
            self._followers.append(tell)

        def end() -> None:
            with self._lock:
                self._followers.remove(tell)

        return end

    def counts(self) -> dict[str, int]:
        """Entries of each kind since rorg began."""
        with self._lock:
            return dict(self._counts)

    @property
    def last(self) -> int:
        """Number of the last entry."""
        with self._lock:
            return self._seq

    def after(self, seq: int, most: int) -> list[dict[str, Any]]:
        """The next entries after a number, at most so many."""
        return self.select(Filter(after=seq), most)

    def since(self, seq: int) -> list[dict[str, Any]]:
        """All entries after a number that are still kept."""
        return self.after(seq, ALL)

    def select(self, filter: Filter, most: int, newest: bool = False) -> list[dict[str, Any]]:
        """The first matching entries, or the newest ones; in their order."""
        with self._lock:
            recent = list(self._recent)
        near = [e for e in recent if filter.matches(e)]
        if recent and recent[0]["seq"] <= filter.after + 1:
            return near[-most:] if newest and most else near[:most]
        condition, args = filter.condition()
        order = "DESC" if newest else "ASC"
        stored = self._stored(f"{condition} ORDER BY seq {order} LIMIT ?", [*args, most])
        # What the disk refused is in memory only.
        entries = {entry["seq"]: entry for entry in (*stored, *near)}
        ordered = [entries[seq] for seq in sorted(entries)]
        return ordered[-most:] if newest and most else ordered[:most]

    def check(self, rest: Callable[[], object]) -> None:
        """Read each entry in the file, so that damage is found before anyone asks. `rest()` is called between two
        slices, so that others can read."""
        after = 0
        while stored := self._stored("seq > ? ORDER BY seq LIMIT ?", [after, SLICE]):
            after = stored[-1]["seq"]
            rest()

    def _stored(self, condition: str, args: list[Any]) -> list[dict[str, Any]]:
        return self.database.read(_entry, f"SELECT {self._columns} FROM entry WHERE {condition}", args)


def checksum(*values: object) -> int:
    """Of the values of an entry, without the checksum."""
    return zlib.crc32("\0".join(map(str, values)).encode())


def fault(path: Path) -> str:
    """Why the history in a file cannot be read; empty if it can, or if there is none."""
    try:
        with reading(path) as database:
            found = database.rows("PRAGMA integrity_check(1)") or [("ok",)]
            Journal(database).check(lambda: None)
    except Invalid as error:
        return error.why
    return "" if found == [("ok",)] else str(found[0][0])


def named(entry: dict[str, Any]) -> list[str]:
    """The services that an entry is about."""
    one = entry.get("service")
    many = (name for key in NAMING for name in entry.get(key) or () if isinstance(name, str))
    return [*([one] if isinstance(one, str) and one else []), *many]


def named_in(more: str) -> list[str]:
    """The same for a stored entry."""
    try:
        fields = json.loads(more)
    except (ValueError, TypeError, RecursionError):
        return []
    return named(fields) if isinstance(fields, dict) else []


def _entry(seq: int, at: str, kind: str, message: str, person: int, more: str, expected: int | None) -> dict[str, Any]:
    """Raises ValueError and TypeError if it is damaged."""
    if expected not in (None, checksum(seq, at, kind, message, person, more)):
        raise ValueError(f"entry {seq} has another checksum")
    return {"seq": seq, "at": at, "kind": kind, "message": message, **json.loads(more)}


def _marks(values: frozenset[str]) -> str:
    return ",".join("?" * len(values))


def _sound(text: str) -> str:
    """The text without what cannot be written as UTF-8."""
    return text.encode(errors="replace").decode()
