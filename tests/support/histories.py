"""The history of a robot, as tests write and read it."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from rorg.history.database import Database, reading
from rorg.history.journal import ABOUT, ENTRY, Journal, checksum
from rorg.model.units import stamp


def wall() -> str:
    return stamp(time.time())


def owned(path: Path) -> Journal:
    """A journal to write to."""
    return Journal(Database(path, wall))


def write_many(path: Path, number: int, message: str, **more: object) -> None:
    """So many entries at once."""
    database = Database(path, wall)
    entries = [(seq, wall(), "told", message, 0, json.dumps(more)) for seq in range(1, number + 1)]
    rows = [(*entry, checksum(*entry)) for entry in entries]
    about = [(more["service"], seq) for seq in range(1, number + 1) if "service" in more]
    assert database.write([(ENTRY, rows), (ABOUT, about)])
    database.close()


def entries(path: Path) -> list[dict]:
    """What is in the file, by a process that does not own it."""
    with reading(path) as database:
        return Journal(database).since(0)


def integrity(path: Path) -> str:
    """What SQLite's own check says."""
    with reading(path) as database:
        return " ".join(str(row[0]) for row in database.rows("PRAGMA integrity_check"))


@contextmanager
def small_disk(folder: Path, size: str) -> Iterator[Path]:
    """A file system of that size."""
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "rorg-tests", folder], check=True)
    try:
        yield folder
    finally:
        subprocess.run(["umount", "--lazy", folder], check=True)
