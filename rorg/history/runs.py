"""The part of the loop's memory that survives a restart: a JSON object for each service."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from typing import Any

from rorg.history.damage import check_types
from rorg.history.database import Change, Database


class Runs:
    """The table of runs, written by the owner of the file, from one thread."""

    def __init__(self, database: Database) -> None:
        self.database = database
        self._written: dict[str, str] = {}
        """The rows that this object read or wrote."""
        self._generation = database.generation

    def read(self) -> dict[str, Any]:
        """The kept memory of each service."""
        rows = self.database.read(_row, "SELECT service, text FROM run")
        self._written = {service: text for service, text, _ in rows}
        return {service: memory for service, _, memory in rows}

    def write(self, texts: Mapping[str, str], gone: Collection[str]) -> bool:
        """Write what is new of services, and remove those that are gone. False if the disk refuses: then the caller
        must try again, with what is new by then."""
        if self._generation != self.database.generation:
            texts, self._written, self._generation = self._written | dict(texts), {}, self.database.generation
        new = {name: text for name, text in texts.items() if self._written.get(name) != text}
        if not new and not gone:
            return True
        change: Change = [
            ("DELETE FROM run WHERE service = ?", [(name,) for name in gone]),
            ("INSERT OR REPLACE INTO run (service, text) VALUES (?, ?)", [*new.items()]),
        ]
        if not self.database.write(change, keep=False):
            return False
        self._written = {name: text for name, text in (self._written | new).items() if name not in gone}
        return True


def _row(service: str, text: str) -> tuple[str, str, Any]:
    """Raises ValueError and TypeError if it is damaged."""
    check_types((service, text), str, str)
    memory = json.loads(text)
    check_types((memory,), dict)
    return service, text, memory
