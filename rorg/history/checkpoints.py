"""Checkpoints bring what was written to the disk, and from the write-ahead log into the database file, in a thread that
may wait for it.

The writer never waits for the disk: its connection syncs nothing (synchronous=OFF). SQLite needs a sync in one case
only: if it restarts the log from the front, over frames that are in the database already, the new header must be on the
disk before the frames (https://sqlite.org/src/info/ff5be73dee). Otherwise a power loss could bring old frames back. So
the writer must not restart it. As long as a reader (`_guard`) holds a mark in the log, SQLite does not; only a
checkpoint that has brought all of it into the database and to the disk, with no writer meanwhile, truncates the log. A
log of length zero has no old frames, and a file system orders the truncation before later writes.
"""

from __future__ import annotations

import contextlib
import sqlite3
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path


class Checkpoints:
    """Of the file at `path`, which is a database already. `quiet()`: no writes during the block; it yields the number
    of transactions so far. All methods raise sqlite3.Error."""

    def __init__(self, path: Path, quiet: Callable[[], AbstractContextManager[int]]) -> None:
        self._quiet = quiet
        self._guard, self._connection = _connect(path), _connect(path)
        try:
            self._connection.execute("PRAGMA synchronous = NORMAL")
            _hold(self._guard)
        except BaseException:
            self.close()
            raise

    def make(self) -> None:
        """Bring everything that was written before this call to the disk."""
        with self._quiet() as before:
            _hold(self._guard)
        _, log, done = self._connection.execute("PRAGMA wal_checkpoint(PASSIVE)").fetchone()
        if done < log:
            return
        with self._quiet() as after:
            if after == before:
                self._guard.execute("ROLLBACK")
                with contextlib.suppress(sqlite3.OperationalError):  # someone reads it: next time
                    self._connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchone()
                _hold(self._guard)

    def damage(self) -> str:
        """What SQLite finds wrong with the file; empty if it finds nothing."""
        row = self._connection.execute("PRAGMA integrity_check(1)").fetchone()
        return "" if row == ("ok",) else str(row and row[0])

    def close(self) -> None:
        """Closing the last connection makes a checkpoint, which syncs."""
        for connection in (self._guard, self._connection):
            with contextlib.suppress(sqlite3.Error):
                connection.close()


def _connect(path: Path) -> sqlite3.Connection:
    return sqlite3.connect(path, timeout=0.0, isolation_level=None, check_same_thread=False)


def _hold(guard: sqlite3.Connection) -> None:
    """Begin to read the newest state, and hold it."""
    if guard.in_transaction:
        guard.execute("ROLLBACK")
    guard.execute("BEGIN")
    guard.execute("SELECT count(*) FROM sqlite_master").fetchone()
