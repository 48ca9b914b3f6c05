"""The journal: one JSON object a line for everything that happened. Kept small: two files of at most MOST bytes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

MOST = 8 << 20


class Journal:
    def __init__(self, path: Path) -> None:
        self.path = path

    def append(self, at: str, kind: str, message: str, **more: Any) -> None:
        """`at` is ISO 8601 in UTC; `kind` a stable word. A full disk loses the line, never the robot."""
        line = json.dumps({"at": at, "kind": kind, "message": message, **more}) + "\n"
        try:
            if self.path.exists() and self.path.stat().st_size > MOST:
                self.path.replace(self.path.with_suffix(".old.jsonl"))
            with self.path.open("a", encoding="utf-8") as file:
                file.write(line)
        except OSError:
            pass
