"""The file of the history: one SQLite database in the state directory, in WAL mode. One rorg writes it, the owner of
the directory; whoever may read the directory reads it at the same time."""

from __future__ import annotations

import contextlib
import errno
import os
import sqlite3
import stat
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from rorg.errors import Invalid
from rorg.history.schema import STEPS
from rorg.store.files import open_private

WAITING = 2000
"""Changes that are kept in memory while the disk refuses them."""
PATIENCE = 0.2
"""Seconds for which a change waits for another process that holds the file, as a tool of SQLite's may."""
READING = 5.0
"""The same for a question."""
DAMAGED = "journal.damaged-*.db"
KEPT_DAMAGED = 2
"""Files that were moved aside, of which the newest stay."""
SPOILT = (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)
Change = Callable[[sqlite3.Connection], None]
"""What a transaction does. It may be called again, where the disk refused it."""


class Database:
    """`wall` gives ISO 8601 in UTC, to the owner, who alone writes; without it the file is only read.

    A change is in the file, for every reader, when write() returns, and survives the end of this process; the disk has
    it after the next checkpoint (see maintenance.py), for which no writer ever waits. While the disk is full or refuses
    writing, changes wait in memory, the last WAITING of them. A file that is damaged is moved aside, and a new one
    begun.
    """

    def __init__(self, path: Path, wall: Callable[[], str] | None = None) -> None:
        self.path, self.wall = path, wall
        self.trouble = ""
        """Why nothing is written now; empty while all is."""
        self.changes = 0
        """So many transactions were written."""
        self._lock, self._reading = threading.RLock(), threading.RLock()
        self._writer: sqlite3.Connection | None = None
        self._reader: sqlite3.Connection | None = None
        self._waiting: deque[Change] = deque(maxlen=WAITING)
        self._notes: list[tuple[str, str]] = []
        self._closed = False

    # -- writing -----------------------------------------------------------------------------------------------

    def write(self, change: Change, keep: bool = True) -> bool:
        """One transaction. False where the disk refuses it: nothing of it is there then, and it is tried again later if
        it is to be kept."""
        with self._lock:
            if not self.trouble and self._carry_out([change]):
                return True
            if keep and self.trouble:
                self._waiting.append(change)
            return False

    def retry(self) -> bool:
        """Writes what waits; False where the disk refuses it still."""
        with self._lock:
            if not self.trouble:
                return True
            waiting, self._waiting = self._waiting, deque(maxlen=WAITING)
            if not self._carry_out(waiting):
                self._waiting = waiting
                return False
            self._note("journal-written", "the journal is written again")
            return True

    def _carry_out(self, changes: Sequence[Change] | deque[Change]) -> bool:
        try:
            self._transaction(changes)
        except (sqlite3.OperationalError, OSError) as error:
            self._refused(error)
            return False
        except (sqlite3.Error, ValueError, OverflowError) as error:
            if not _spoilt(error):
                self._note("internal-error", f"internal error: the journal cannot hold an entry: {error}")
                return False
            self._set_aside(str(error))
            try:
                self._transaction(changes)
            except (sqlite3.Error, OSError) as again:
                self._refused(again)
                return False
        self.trouble = ""
        return True

    def _transaction(self, changes: Sequence[Change] | deque[Change]) -> None:
        if self._closed or self.wall is None:
            raise OSError(errno.EBADF, "it is not open for writing")
        if self._writer is None:
            self._writer = self._open_writer()
        connection = self._writer
        connection.execute("BEGIN IMMEDIATE")
        try:
            for change in changes:
                change(connection)
            connection.execute("COMMIT")
        except BaseException:
            with contextlib.suppress(sqlite3.Error):
                connection.execute("ROLLBACK")
            raise
        self.changes += 1

    def _refused(self, error: Exception) -> None:
        why = getattr(error, "strerror", None) or str(error)
        if not self.trouble:
            self._note("journal-not-written", f"the journal {self.path} cannot be written: {why}; it is tried again")
        self.trouble = why
        self._close_writer()

    def _open_writer(self) -> sqlite3.Connection:
        self._close_reader()  # a lock of ours on the file ends with every descriptor of it that we close
        _check_regular(self.path)
        os.close(open_private(self.path, os.O_RDWR))
        try:
            return self._opened()
        except sqlite3.DatabaseError as error:
            if not _spoilt(error):
                raise
            self._set_aside(str(error))
            return self._opened()

    def _opened(self) -> sqlite3.Connection:
        connection = sqlite3.connect(self.path, PATIENCE, isolation_level=None, check_same_thread=False)
        try:
            connection.execute("PRAGMA journal_mode = WAL")
            # Checkpoints are for the thread that may wait for the disk.
            connection.execute("PRAGMA wal_autocheckpoint = 0")
            connection.execute("PRAGMA synchronous = NORMAL")
            version = connection.execute("PRAGMA user_version").fetchone()[0]
            if version > len(STEPS):
                raise _Newer(f"it is of version {version}, which a newer rorg wrote")
            for number, step in enumerate(STEPS[version:], version + 1):
                connection.executescript(f"BEGIN IMMEDIATE;{step}PRAGMA user_version = {number};COMMIT;")
        except BaseException:
            connection.close()
            raise
        return connection

    def _set_aside(self, why: str) -> None:
        """Moves the file away. Raises OSError."""
        self.close()
        self._closed = False
        stamp = (self.wall() if self.wall else "").replace(":", "")
        aside = self.path.with_name(f"journal.damaged-{stamp}.db")
        for end in ("-wal", "-shm", ""):
            with contextlib.suppress(FileNotFoundError):
                self.path.with_name(self.path.name + end).rename(f"{aside}{end}")
        for old in sorted(self.path.parent.glob(DAMAGED))[:-KEPT_DAMAGED]:
            for end in ("", "-wal", "-shm"):
                old.with_name(old.name + end).unlink(missing_ok=True)
        self._note("journal-damaged", f"the journal was damaged ({why}): it is kept as {aside}, and a new one begun")

    def _note(self, kind: str, message: str) -> None:
        self._notes.append((kind, message))

    def take_notes(self) -> list[tuple[str, str]]:
        """What happened to the file since this was asked last: kinds and messages of events."""
        with self._lock:
            notes, self._notes = self._notes, []
        return notes

    # -- reading -----------------------------------------------------------------------------------------------

    def rows(self, sql: str, args: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        """What the file answers; nothing where there is none. The owner is answered nothing as well where it cannot be
        read, others are told: raises Invalid."""
        with self._reading:
            try:
                return self._answer(sql, args)
            except FileNotFoundError:
                return []
            except (sqlite3.Error, OSError) as error:
                self._close_reader()
                if self.wall is not None:
                    return []
                remedy = f"fixing or moving {self.path}"
                raise Invalid("read the journal", f"{self.path}: {error}", remedy) from error

    def _answer(self, sql: str, args: Sequence[Any]) -> list[tuple[Any, ...]]:
        if self._reader is None:
            if self.wall is not None:
                self.write(lambda _: None, keep=False)  # it is there, and its tables are
            self._reader = self._open_reader()
        return self._reader.execute(sql, args).fetchall()

    def _open_reader(self) -> sqlite3.Connection:
        _check_regular(self.path)
        os.stat(self.path)
        # Without a WAL nobody writes it; then it is read as it is, which needs no right to write beside it.
        alone = not os.path.exists(f"{self.path}-wal")
        place = f"{self.path.resolve().as_uri()}?mode=ro" + "&immutable=1" * alone
        return sqlite3.connect(place, READING, isolation_level=None, check_same_thread=False, uri=True)

    # -- the end -----------------------------------------------------------------------------------------------

    def _close_writer(self) -> None:
        connection, self._writer = self._writer, None
        if connection is not None:
            with contextlib.suppress(sqlite3.Error):
                connection.close()

    def _close_reader(self) -> None:
        with self._reading:
            connection, self._reader = self._reader, None
            if connection is not None:
                with contextlib.suppress(sqlite3.Error):
                    connection.close()

    def close(self) -> None:
        """Afterwards nothing is written."""
        self._close_reader()
        with self._lock:
            self._closed = True
            self._close_writer()


class _Newer(sqlite3.DatabaseError):
    """The file is of a later version."""


def _spoilt(error: Exception) -> bool:
    return isinstance(error, _Newer) or (getattr(error, "sqlite_errorcode", 0) & 0xFF) in SPOILT


def _check_regular(path: Path) -> None:
    """Raises OSError where something else lies in the place of one of its files: to open a pipe would wait."""
    for end in ("", "-wal", "-shm"):
        with contextlib.suppress(FileNotFoundError):
            if not stat.S_ISREG(os.stat(f"{path}{end}").st_mode):
                raise OSError(errno.EINVAL, "it is not a regular file", f"{path}{end}")


@contextlib.contextmanager
def reading(path: Path) -> Iterator[Database]:
    """The history in a file, for as long as the block runs."""
    database = Database(path)
    try:
        yield database
    finally:
        database.close()
