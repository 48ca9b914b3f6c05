"""The journal: one JSON object a line for everything that happened, numbered. Kept small: two files of at most MOST
bytes, twice, and the last lines in memory for those who follow. What people did stands apart from the rest, so that no
service that does much ever pushes it out."""

from __future__ import annotations

import contextlib
import json
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from itertools import islice
from operator import itemgetter
from pathlib import Path
from typing import Any, BinaryIO

from rorg.store.files import open_private, read_state, regular

MOST = 8 << 20
RECENT = 2000
"""Lines kept in memory."""
FORMS = {"at": str, "kind": str, "message": str, "service": str, "services": list, "requests": list, "shed": dict}
"""What those who read lines go by."""
NEAR = 1 << 13
"""Bytes of a file that are read through in search of a line."""


class _Lines:
    """Lines in a file, and the file before it."""

    def __init__(self, path: Path) -> None:
        self.path, self.old = path, path.with_suffix(".old.jsonl")
        self._begin = b"\n" if _is_torn(path) else b""
        """What ends half a last line, which a machine that lost power may have left."""

    def append(self, line: str) -> None:
        """Raises OSError."""
        descriptor = open_private(self.path, os.O_WRONLY | os.O_APPEND)
        with open(descriptor, "ab") as file:
            file.write(self._begin + line.encode() + b"\n")
            size = file.tell()
        self._begin = b""
        if size > MOST:
            self.path.replace(self.old)

    def after(self, seq: int, most: int) -> list[dict[str, Any]]:
        found = _after(self.old, seq, most)
        return found + _after(self.path, seq, most - len(found)) if len(found) < most else found

    def entries(self) -> list[dict[str, Any]]:
        return [*_entries(self.old), *_entries(self.path)]


class Journal:
    """`seq` numbers lines without a gap as long as the files are there, across restarts of rorg."""

    def __init__(self, path: Path) -> None:
        self._lock = threading.Lock()
        self._all, self._people = _Lines(path), _Lines(path.with_suffix(".people.jsonl"))
        kept = _merged(_entries(self._all.path), _entries(self._people.path))
        self._recent: deque[dict[str, Any]] = deque(kept[-RECENT:], maxlen=RECENT)
        self._seq: int = self._recent[-1]["seq"] if self._recent else 0
        self._followers: list[Callable[[], None]] = []

    def append(self, at: str, kind: str, message: str, person: bool = False, **more: Any) -> None:
        """`at` is ISO 8601 in UTC; `kind` a stable word; `person` says that a person did it. A full disk loses the
        line, never the robot."""
        with self._lock:
            self._seq += 1
            entry = {"seq": self._seq, "at": at, "kind": kind, "message": message, **more}
            self._recent.append(entry)
            with contextlib.suppress(OSError):
                (self._people if person else self._all).append(json.dumps(entry))
            followers = tuple(self._followers)
        for tell in followers:
            tell()

    def follow(self, tell: Callable[[], None]) -> Callable[[], None]:
        """Has `tell` called after every line, in the thread that wrote it, until what this returns is called."""
        with self._lock:
            self._followers.append(tell)

        def end() -> None:
            with self._lock:
                self._followers.remove(tell)

        return end

    @property
    def last(self) -> int:
        """Number of the last line."""
        with self._lock:
            return self._seq

    def after(self, seq: int, most: int) -> list[dict[str, Any]]:
        """The next lines after a number, so many at the most."""
        with self._lock:
            recent = list(self._recent)
        if recent and recent[0]["seq"] > seq + 1:
            found = _merged(self._all.after(seq, most), self._people.after(seq, most))
            if found:
                return found[:most]
        return [e for e in recent if e["seq"] > seq][:most]

    def since(self, seq: int) -> list[dict[str, Any]]:
        """All lines after a number, as far as they are kept."""
        with self._lock:
            recent = list(self._recent)
        if seq >= self._seq or not recent:
            return []
        if recent[0]["seq"] > seq + 1:
            recent = _merged(self._all.entries(), self._people.entries())
        return [e for e in recent if e["seq"] > seq]


def _after(path: Path, seq: int, most: int) -> list[dict[str, Any]]:
    """The next lines after a number, found by halves: the file may be large, and who reads it slow."""
    try:
        with open(regular(path, os.O_RDONLY), "rb") as file:
            low, high = 0, file.seek(0, os.SEEK_END)
            while high - low > NEAR:
                middle = (low + high) // 2
                file.seek(middle)
                file.readline()
                first = next(_whole(file), None)
                low, high = (middle, high) if first and first["seq"] <= seq else (low, middle)
            file.seek(low)
            if low:
                file.readline()
            return list(islice((entry for entry in _whole(file) if entry["seq"] > seq), most))
    except OSError:
        return []


def _whole(file: BinaryIO) -> Iterator[dict[str, Any]]:
    while line := file.readline():
        if entry := _entry(line.decode("utf-8", errors="replace")):
            yield entry


def _merged(*entries: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return sorted((entry for some in entries for entry in some), key=itemgetter("seq"))


def _is_torn(path: Path) -> bool:
    try:
        with open(regular(path, os.O_RDONLY), "rb") as file:
            return bool(file.seek(0, 2)) and file.seek(-1, 2) >= 0 and file.read(1) != b"\n"
    except OSError:
        return False


def _entries(path: Path) -> list[dict[str, Any]]:
    """The lines that are whole. A machine that lost power may have left half of one, at the end or, with later lines
    behind it, anywhere."""
    try:
        lines = read_state(path).splitlines()
    except OSError:
        return []
    return [entry for line in lines if (entry := _entry(line)) is not None]


def _entry(line: str) -> dict[str, Any] | None:
    try:
        entry = json.loads(line)
    except (ValueError, RecursionError):
        return None
    if not isinstance(entry, dict) or type(entry.get("seq")) is not int or not {"at", "kind", "message"} <= set(entry):
        return None
    sound = all(isinstance(entry[key], form) for key, form in FORMS.items() if key in entry)
    texts = (text for key in ("services", "requests") for text in entry.get(key, ()))
    return entry if sound and all(isinstance(text, str) for text in texts) else None
