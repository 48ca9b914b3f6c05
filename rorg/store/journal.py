"""The journal: one JSON object a line for everything that happened, numbered. Kept small: two files of at most MOST
bytes, and the last lines in memory for those who follow."""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rorg.store.files import appendable, read_state

MOST = 8 << 20
RECENT = 2000
"""Lines kept in memory."""
FORMS = {"at": str, "kind": str, "message": str, "service": str, "services": list, "requests": list, "shed": dict}
"""What those who read lines go by."""


class Journal:
    """`seq` numbers lines without a gap as long as the files are there, across restarts of rorg."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        self._recent: deque[dict[str, Any]] = deque(_entries(path)[-RECENT:], maxlen=RECENT)
        self._seq: int = self._recent[-1]["seq"] if self._recent else 0
        self._begin = "\n" if _is_torn(path) else ""
        """What ends half a last line, which a machine that lost power may have left."""
        self._followers: list[Callable[[], None]] = []

    def append(self, at: str, kind: str, message: str, **more: Any) -> None:
        """`at` is ISO 8601 in UTC; `kind` a stable word. A full disk loses the line, never the robot."""
        with self._lock:
            self._seq += 1
            entry = {"seq": self._seq, "at": at, "kind": kind, "message": message, **more}
            self._recent.append(entry)
            try:
                if self.path.is_file() and self.path.stat().st_size > MOST:
                    self.path.replace(self._old)
                with open(appendable(self.path), "a", encoding="utf-8") as file:
                    file.write(self._begin + json.dumps(entry) + "\n")
                self._begin = ""
            except OSError:
                pass
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
    def _old(self) -> Path:
        return self.path.with_suffix(".old.jsonl")

    @property
    def last(self) -> int:
        """Number of the last line."""
        with self._lock:
            return self._seq

    def since(self, seq: int) -> list[dict[str, Any]]:
        """All lines after a number, as far as they are kept."""
        with self._lock:
            recent = list(self._recent)
        if seq >= self._seq or not recent:
            return []
        if recent[0]["seq"] > seq + 1:
            recent = [*_entries(self._old), *_entries(self.path)]
        return [e for e in recent if e["seq"] > seq]


def _is_torn(path: Path) -> bool:
    try:
        return read_state(path)[-1:] not in ("", "\n")
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
