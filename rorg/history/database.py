"""The file of the history: one SQLite database in the state directory, in WAL mode. One rorg writes it, the owner of
the directory. Everyone who may read the directory can read it at the same time."""

from __future__ import annotations

import contextlib
import errno
import os
import sqlite3
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, TypeVar

from rorg.errors import Invalid
from rorg.history.checkpoints import Checkpoints
from rorg.history.damage import Damaged, check_header, is_damage, move_aside
from rorg.history.reader import Reader, check_regular
from rorg.history.schema import migrate
from rorg.store.files import open_private

WAITING = 2000
"""Changes that are kept in memory while the disk refuses them."""
PAGE = 1024
"""Bytes of a page. Each change writes the pages that it touches, so small ones spare the disk."""
PATIENCE = 0.2
"""Seconds for which a change waits for another process that holds the file, such as an SQLite tool."""
Change = Sequence[tuple[str, Sequence[Sequence[Any]]]]
"""The content of a transaction: SQL statements, each with the rows of values to execute it for."""
T = TypeVar("T")


class Database:
    """`wall` gives ISO 8601 in UTC. Only the owner passes it, and writes; others only read.

    When write() returns, a change is in the file for every reader and survives the end of this process. The disk has it
    after the next checkpoint (see maintenance.py), for which no writer waits. While the disk is full or refuses writes,
    the last WAITING changes are kept in memory. A damaged file is moved aside, and a new one begun.
    """

    def __init__(self, path: Path, wall: Callable[[], str] | None = None) -> None:
        self.path, self.wall = path, wall
        self.trouble = ""
        """Why nothing can be written now; empty if it can."""
        self.changes = 0
        """Number of transactions that were written."""
        self.changed = threading.Event()
        """Set when there is work for maintenance."""
        self.generation = 0
        """Increases with every new file, which does not have what was written before."""
        self._lock = threading.RLock()
        """If the reader's lock is needed too, this one must be taken first."""
        self._writer: sqlite3.Connection | None = None
        self._reader = Reader(path)
        self._checkpoints: Checkpoints | None = None
        self._at_work = False
        """Whether the checkpoints are in use."""
        self._done = 0
        """The number of transactions at the last checkpoint."""
        self._inode = 0
        self._waiting: deque[Change] = deque(maxlen=WAITING)
        self._notes: list[tuple[str, str]] = []

    # -- writing -----------------------------------------------------------------------------------------------

    def write(self, change: Change, keep: bool = True) -> bool:
        """Make one transaction. False if the disk refuses it: then nothing of it is in the file, and with `keep` it is
        tried again later."""
        with self._lock:
            if not self.trouble and self._carry_out([change]):
                return True
            if keep and self.trouble:
                self._waiting.append(change)
            self.changed.set()
            return False

    def retry(self) -> bool:
        """Write what waits; False if the disk still refuses it."""
        with self._lock:
            if not self.trouble:
                return True
            waiting, self._waiting = self._waiting, deque(maxlen=WAITING)
            if not self._carry_out(waiting):
                self._waiting = waiting
                self.changed.set()
                return False
            self._note("journal-written", "the journal is written again")
            return True

    def _carry_out(self, changes: Sequence[Change]) -> bool:
        try:
            self._transaction(changes)
        except (sqlite3.Error, OSError, ValueError, OverflowError) as error:
            if not is_damage(error):
                if isinstance(error, sqlite3.OperationalError | OSError):
                    self._refused(error)
                else:
                    self._note("internal-error", f"internal error: the journal cannot hold an entry: {error}")
                return False
            try:
                self._set_aside(error)
                self._transaction(changes)
            except (sqlite3.Error, OSError) as again:
                self._refused(again)
                return False
        self.trouble = ""
        return True

    def _transaction(self, changes: Sequence[Change]) -> None:
        connection = self._writer or self._open_writer()
        connection.execute("BEGIN IMMEDIATE")
        try:
            for change in changes:
                for sql, rows in change:
                    connection.executemany(sql, rows)
            connection.execute("COMMIT")
        except BaseException:
            with contextlib.suppress(sqlite3.Error):
                connection.execute("ROLLBACK")
            raise
        self.changes += 1
        self.changed.set()

    def _refused(self, error: Exception) -> None:
        why = getattr(error, "strerror", None) or str(error)
        if not self.trouble:
            self._note("journal-not-written", f"the journal {self.path} cannot be written: {why}; it is tried again")
        self.trouble = why
        self.close()

    def _open_writer(self) -> sqlite3.Connection:
        if self.wall is None:
            raise OSError(errno.EBADF, "it was opened for reading")
        self.close()  # closing any descriptor of the file would end our locks on it
        try:
            self._writer = self._opened()
        except (sqlite3.DatabaseError, UnicodeDecodeError) as error:
            if not is_damage(error):
                raise
            self._set_aside(error)
            self._writer = self._opened()
        self._inode = os.stat(self.path).st_ino
        return self._writer

    def _opened(self) -> sqlite3.Connection:
        check_regular(self.path)
        os.close(open_private(self.path, os.O_RDWR))
        check_header(self.path)
        connection = sqlite3.connect(self.path, timeout=PATIENCE, isolation_level=None, check_same_thread=False)
        try:
            connection.execute(f"PRAGMA page_size = {PAGE}")
            connection.execute("PRAGMA journal_mode = WAL")
            # Only checkpoints wait for the disk: see there.
            connection.execute("PRAGMA wal_autocheckpoint = 0")
            connection.execute("PRAGMA synchronous = OFF")
            self.generation += migrate(connection)
        except BaseException:
            connection.close()
            raise
        return connection

    def _set_aside(self, error: Exception) -> None:
        """Move the file away. Raises OSError."""
        self.close()
        why = str(error).partition(" with text")[0]  # Python repeats a text that is no UTF-8
        aside = move_aside(self.path, self.wall() if self.wall else "")
        self._note("journal-damaged", f"the journal was damaged ({why}): it is kept as {aside}, and a new one begun")

    def _replace(self, generation: int, error: Exception) -> None:
        """Begin a new file in place of a damaged one, unless another thread has done so since that generation."""
        with self._lock, contextlib.suppress(OSError):
            if generation == self.generation and is_damage(error):
                self._set_aside(error)
                self._make()

    def _note(self, kind: str, message: str) -> None:
        self._notes.append((kind, message))

    def take_notes(self) -> list[tuple[str, str]]:
        """Events about the file since the last call: kinds and messages."""
        with self._lock:
            notes, self._notes = self._notes, []
        return notes

    # -- what may wait for the disk ----------------------------------------------------------------------------

    def checkpoint(self) -> None:
        """Bring everything that was written before to the disk, unless it refuses."""
        with self._lock:
            if self._writer and not self._in_place():
                self.close()  # the file was removed: the next change begins a new one
            if self._writer is None or self.changes == self._done:
                return
            upto = self.changes
        if self._use(Checkpoints.make):
            self._done = upto

    def check(self) -> None:
        """Move the file aside if SQLite finds it damaged."""

        def look(checkpoints: Checkpoints) -> None:
            if damage := checkpoints.damage():
                raise Damaged(damage)

        self._use(look)

    def _use(self, use: Callable[[Checkpoints], None]) -> bool:
        """False if the disk refuses. If the file was closed meanwhile, the checkpoints are closed afterwards."""
        checkpoints = None
        try:
            with self._lock:
                generation = self.generation
                if self._writer:
                    self._checkpoints = self._checkpoints or Checkpoints(self.path, self._quiet)
                checkpoints, self._at_work = self._checkpoints, True
            if checkpoints:
                use(checkpoints)
            return True
        except (sqlite3.Error, UnicodeDecodeError) as error:
            self.changed.set()
            self._replace(generation, error)
            return False
        finally:
            with self._lock:
                self._at_work = False
                if checkpoints and checkpoints is not self._checkpoints:
                    checkpoints.close()

    def _in_place(self) -> bool:
        try:
            return os.stat(self.path).st_ino == self._inode
        except OSError:
            return False

    @contextlib.contextmanager
    def _quiet(self) -> Iterator[int]:
        with self._lock:
            yield self.changes

    # -- reading -----------------------------------------------------------------------------------------------

    def rows(self, sql: str, args: Sequence[Any] = ()) -> list[tuple[Any, ...]]:
        """Rows of the file; none if it is missing. If it cannot be read, the owner gets none either; others get
        Invalid."""
        return self.read(lambda *row: row, sql, args)

    def read(self, make: Callable[..., T], sql: str, args: Sequence[Any] = ()) -> list[T]:
        """What `make` returns for each of these rows. It raises ValueError, TypeError or LookupError for values that
        rorg does not write: then the file is damaged."""
        if self.wall is not None:
            self._make()
        generation = self.generation
        try:
            return _made(make, self._reader.rows(sql, args))
        except FileNotFoundError:
            return []
        except (sqlite3.Error, OSError, UnicodeDecodeError) as error:
            self._reader.close()
            if self.wall is not None:
                self._replace(generation, error)
                return []
            raise Invalid("read the journal", f"{self.path}: {error}", f"to fix or move {self.path}") from error

    def _make(self) -> None:
        """Create its tables, if the disk allows it."""
        with self._lock:
            if self._writer is None and not self.trouble:
                self._carry_out([])

    # -- the end -----------------------------------------------------------------------------------------------

    def close(self) -> None:
        """Close it until the next use."""
        with self._lock:
            self._reader.close()
            writer, self._writer = self._writer, None
            checkpoints, self._checkpoints = self._checkpoints, None
            with contextlib.suppress(sqlite3.Error):
                if writer:
                    # Closing the last one brings everything into the file, which must be on the disk before the log
                    # goes.
                    writer.execute("PRAGMA synchronous = NORMAL")
                    writer.close()
            if checkpoints and not self._at_work:
                checkpoints.close()


def _made(make: Callable[..., T], rows: Sequence[tuple[Any, ...]]) -> list[T]:
    try:
        return [make(*row) for row in rows]
    except (ValueError, TypeError, LookupError, RecursionError) as error:
        raise Damaged(f"a row is not as rorg writes it: {error}") from error


def reading(path: Path) -> AbstractContextManager[Database]:
    """The history in a file, during the block."""
    return contextlib.closing(Database(path))
