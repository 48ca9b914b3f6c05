"""What of the loop's memory outlives it: a JSON object for each service."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Collection, Mapping
from typing import Any

from rorg.history.database import Database


class Runs:
    """The table of runs, written by the owner of the file, from one thread."""

    def __init__(self, database: Database) -> None:
        self.database = database
        self._written: dict[str, str] = {}
        """What is in the table, as far as this object wrote it."""
        self._generation = database.generation

    def read(self) -> dict[str, Any]:
        """What is kept of each service. What is no JSON, whoever wrote it, is passed over."""
        found = {}
        for service, text in self.database.rows("SELECT service, text FROM run"):
            try:
                found[service] = json.loads(text)
            except (ValueError, TypeError, RecursionError):
                continue
        return found

    def write(self, texts: Mapping[str, str], gone: Collection[str]) -> bool:
        """Writes what is new of services, and forgets those that are gone. False where the disk refuses it: then it is
        to be tried again, with what is new by then."""
        if self._generation != self.database.generation:
            texts, self._written, self._generation = self._written | dict(texts), {}, self.database.generation
        new = {name: text for name, text in texts.items() if self._written.get(name) != text}
        if not new and not gone:
            return True

        def change(connection: sqlite3.Connection) -> None:
            connection.executemany("DELETE FROM run WHERE service = ?", [(name,) for name in gone])
            connection.executemany("INSERT OR REPLACE INTO run (service, text) VALUES (?, ?)", list(new.items()))

        if not self.database.write(change, keep=False):
            return False
        self._written = {name: text for name, text in (self._written | new).items() if name not in gone}
        return True
