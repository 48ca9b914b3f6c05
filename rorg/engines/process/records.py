"""The records on disk, one folder for each container, and the state of each."""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rorg.engines.process.table import is_same, known, stat
from rorg.errors import EngineError
from rorg.store.files import make_directory, read_state, write_atomic

Record = Mapping[str, Any]
"""id, name, spec, labels, live and created_at; after a start also pid, ticks, boot, log_from and started_at."""
LISTS = ("entrypoint", "command", "inherit_environment")
FORMS = {"name": str, "spec": dict, "labels": dict, "live": dict}
STARTED = {"pid": int, "ticks": int, "boot": str, "log_from": int, "started_at": str}
MOST_PID = 1 << 22
"""Of Linux."""


class Records:
    """`children` are the leaders that this rorg itself started: the kernel keeps their exit codes until they are waited
    for."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.children: dict[str, subprocess.Popen[bytes]] = {}
        make_directory(directory)

    def ids(self) -> list[str]:
        """Ids of all records. Raises Unreachable."""
        try:
            return sorted(p.name for p in self.directory.iterdir() if os.path.lexists(p / "record.json"))
        except OSError as error:
            known(error, str(self.directory))
            raise

    def folder(self, container: str) -> Path:
        return self.directory / container

    def log(self, container: str) -> Path:
        return self.folder(container) / "log"

    def read(self, container: str) -> dict[str, Any]:
        """Raises EngineError: of kind gone if it is missing, other if it is not a record; Unreachable if it cannot be
        read at the moment."""
        path = self.folder(container) / "record.json"
        if not os.path.lexists(path):
            raise EngineError(f"find {container}", "no such container", kind="gone")
        record = _json(path)
        if not isinstance(record, dict) or record.get("id") != container or not _whole(record):
            raise EngineError(
                f"find {container}", f"{path} cannot be read", "to end its processes and remove its folder"
            )
        return record

    def write(self, record: Record) -> None:
        write_atomic(self.folder(record["id"]) / "record.json", json.dumps(record), mode=0o600)

    def state(self, record: Record) -> tuple[str, int | None]:
        """(created, running, paused or exited; the exit code of the last run). Raises Unreachable."""
        if not record.get("pid"):
            return "created", None
        child = self.children.get(record["id"])
        if child is not None:
            child.poll()
        if is_same(record["pid"], record["ticks"], record["boot"], record["id"]):
            facts = stat(record["pid"])
            return ("paused" if facts and facts[0] == "T" else "running"), None
        try:
            return "exited", int(read_state(self.folder(record["id"]) / "exit"))
        except OSError as error:
            known(error, f"the exit code of {record['id'][:12]}")
        except ValueError:
            pass
        return "exited", 137


def _json(path: Path) -> Any:
    """The content of a file, or None if it has none. Raises Unreachable if it cannot be read at the moment."""
    try:
        return json.loads(read_state(path))
    except OSError as error:
        known(error, str(path))
    except (ValueError, RecursionError):
        pass
    return None


def _whole(record: Record) -> bool:
    """Whether this is a record that write() could have written."""
    sound = all(isinstance(record.get(key), form) for key, form in FORMS.items())
    sound = sound and all(isinstance(text, str) for text in record["labels"].values()) and _startable(record["spec"])
    if not sound or "pid" not in record:
        return sound
    return all(type(record.get(key)) is form for key, form in STARTED.items()) and 0 < record["pid"] <= MOST_PID


def _startable(spec: Mapping[str, Any]) -> bool:
    """Whether the fields of a spec that a start needs have the right types."""
    environment, words = spec.get("environment", {}), (spec.get(key, []) for key in LISTS)
    return (
        isinstance(spec.get("image"), str)
        and isinstance(environment, dict)
        and all(isinstance(text, str) for text in environment.values())
        and all(isinstance(listed, list) and all(isinstance(word, str) for word in listed) for listed in words)
    )
