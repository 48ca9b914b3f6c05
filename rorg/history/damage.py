"""Damage of the history's file: what counts as damage, and where a damaged file is kept."""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Iterable
from pathlib import Path
from types import UnionType

ASIDE = "journal.damaged-*.db"
KEPT = 2
"""Damaged files that are kept, the newest ones."""
CODES = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
HEADER = slice(16, 24), b"\x04\x00\x02\x02\x00\x40\x20\x20", b"\x04\x00\x01\x01\x00\x40\x20\x20"
"""Where a file's header has the size of a page and the format, and these in a file of rorg's, with a WAL and before it
has one (https://sqlite.org/fileformat.html). SQLite takes some wrong formats for a file that may only be read."""


class Damaged(sqlite3.DatabaseError):
    """This file is not as rorg wrote it."""


def is_damage(error: Exception) -> bool:
    """Whether an error means that the file is damaged, rather than that the disk or another process refuses it."""
    code = getattr(error, "sqlite_errorcode", None)
    if code is not None:
        return code & 0xFF in CODES
    # Python raises the last two if a text, or a name in a message of SQLite's, is no UTF-8.
    return isinstance(error, Damaged | sqlite3.OperationalError | UnicodeDecodeError)


def check_types(values: Iterable[object], *types: type | UnionType) -> None:
    """Raises TypeError if a value is not of the type in its place."""
    for value, type in zip(values, types, strict=True):
        if not isinstance(value, type):
            raise TypeError(f"{value!r:.40} is not of the type {type}")


def check_header(path: Path) -> None:
    """Raises Damaged, and OSError."""
    with path.open("rb") as file:
        head = file.read(100)
    place, *right = HEADER
    if head and head[place] not in right:
        raise Damaged("its header is not rorg's")


def damaged_files(folder: Path) -> list[Path]:
    """The damaged files that are kept in a state directory, oldest first."""
    return sorted(folder.glob(ASIDE))


def move_aside(path: Path, stamp: str) -> Path:
    """Move a damaged file away, and return its new place. Raises OSError."""
    aside = path.with_name(ASIDE.replace("*", stamp.replace(":", "")))
    for end in ("-wal", "-shm", ""):
        with contextlib.suppress(FileNotFoundError):
            path.with_name(path.name + end).rename(f"{aside}{end}")
    for old in damaged_files(path.parent)[:-KEPT]:
        for end in ("", "-wal", "-shm"):
            old.with_name(old.name + end).unlink(missing_ok=True)
    return aside
