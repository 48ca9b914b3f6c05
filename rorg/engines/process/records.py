"""The records on disk, one folder a container, and what state each is in."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rorg.engines.process.table import is_same, stat
from rorg.errors import EngineError
from rorg.store.files import make_directory, write_atomic
from rorg.store.state_dir import read_json

Record = Mapping[str, Any]
"""id, name, spec, labels, live and created_at; once it was started pid, ticks, boot, log_from and started_at."""


class Records:
    """`children` are the leaders that this rorg started itself: the kernel keeps their ends until they are waited
    for."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.children: dict[str, subprocess.Popen[bytes]] = {}
        make_directory(directory)

    def ids(self) -> list[str]:
        return sorted(p.name for p in self.directory.iterdir() if (p / "record.json").exists())

    def folder(self, container: str) -> Path:
        return self.directory / container

    def log(self, container: str) -> Path:
        return self.folder(container) / "log"

    def read(self, container: str) -> dict[str, Any]:
        """Raises EngineError (gone) where there is none that is whole."""
        record = read_json(self.folder(container) / "record.json") or {}
        if not {"id", "name", "spec", "labels", "live"} <= set(record):
            raise EngineError(f"find {container}", "no such container", kind="gone")
        return record

    def write(self, record: Record) -> None:
        write_atomic(self.folder(record["id"]) / "record.json", json.dumps(record), mode=0o600)

    def state(self, record: Record) -> tuple[str, int | None]:
        """created, running, paused or exited; and the exit code of the last."""
        if not record.get("pid"):
            return "created", None
        child = self.children.get(record["id"])
        if child is not None:
            child.poll()
        if is_same(record["pid"], record["ticks"], record["boot"], record["id"]):
            facts = stat(record["pid"])
            return ("paused" if facts and facts[0] == "T" else "running"), None
        try:
            return "exited", int((self.folder(record["id"]) / "exit").read_text())
        except (OSError, ValueError):
            return "exited", 137
