"""Reads the file of the history while another process may write it."""

from __future__ import annotations

import contextlib
import errno
import os
import sqlite3
import stat
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from rorg.history.schema import STEPS, migrate

PATIENCE = 5.0
"""Seconds to wait for another process that holds the file."""


class Reader:
    """One connection, opened by the first question and by the first one after close()."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        self._connection: sqlite3.Connection | None = None

    def rows(self, sql: str, args: Sequence[Any]) -> list[tuple[Any, ...]]:
        """Rows of the file. Raises FileNotFoundError if it is missing or has no tables yet; OSError and sqlite3.Error
        if it cannot be read."""
        with self._lock:
            self._connection = self._connection or self._open()
            return self._connection.execute(sql, args).fetchall()

    def _open(self) -> sqlite3.Connection:
        check_regular(self.path)
        os.stat(self.path)
        # Without a WAL there is no writer. Then it is read as it is, without the right to write beside it.
        alone = not os.path.exists(f"{self.path}-wal")
        place = f"file:{quote(os.fsencode(self.path))}?mode=ro" + "&immutable=1" * alone
        connection = sqlite3.connect(place, timeout=PATIENCE, isolation_level=None, check_same_thread=False, uri=True)
        version = connection.execute("PRAGMA user_version").fetchone()[0]
        if not version:
            connection.close()
            raise FileNotFoundError(errno.ENOENT, "it has no tables yet", str(self.path))
        return connection if version >= len(STEPS) else _upgraded(connection)

    def close(self) -> None:
        """Close it until the next question."""
        with self._lock:
            connection, self._connection = self._connection, None
            if connection is not None:
                with contextlib.suppress(sqlite3.Error):
                    connection.close()


def _upgraded(connection: sqlite3.Connection) -> sqlite3.Connection:
    """A copy in memory, with the tables of now: only the owner may upgrade the file of an older rorg."""
    copy = sqlite3.connect(":memory:", isolation_level=None, check_same_thread=False)
    with contextlib.closing(connection):
        connection.backup(copy)
    migrate(copy)
    return copy


def check_regular(path: Path) -> None:
    """Raises OSError if one of its files is not regular: opening a pipe would wait."""
    for end in ("", "-wal", "-shm"):
        with contextlib.suppress(FileNotFoundError):
            if not stat.S_ISREG(os.stat(f"{path}{end}").st_mode):
                raise OSError(errno.EINVAL, "it is not a regular file", f"{path}{end}")
