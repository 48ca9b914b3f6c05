"""The file of the history: one SQLite database in the state directory, in WAL mode. One rorg writes it, the owner of
the directory; whoever may read the directory reads it at the same time."""

from __future__ import annotations

import contextlib
import errno
import os
import sqlite3
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from rorg.errors import Invalid
from rorg.history.checkpoints import Checkpoints
from rorg.history.reader import Reader, check_regular
from rorg.history.schema import STEPS
from rorg.store.files import open_private

WAITING = 2000
"""Changes that are kept in memory while the disk refuses them."""
PAGE = 1024
"""Bytes of a page. Each change writes the pages that it touches, so small ones spare the disk."""
PATIENCE = 0.2
"""Seconds for which a change waits for another process that holds the file, as a tool of SQLite's may."""
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
        self.changed = threading.Event()
        """Set when there is something for maintenance to do."""
        self.generation = 0
        """Another one with every new file: what was written is not in it."""
        self._lock = threading.RLock()
        """Who needs the reader's too takes this one first."""
        self._writer: sqlite3.Connection | None = None
        self._reader = Reader(path)
        self._checkpoints: Checkpoints | None = None
        self._at_work = False
        """Whether they are being used."""
        self._done = 0
        """The number of transactions at the last checkpoint."""
        self._inode = 0
        self._waiting: deque[Change] = deque(maxlen=WAITING)
        self._notes: list[tuple[str, str]] = []

    # -- writing -----------------------------------------------------------------------------------------------

    def write(self, change: Change, keep: bool = True) -> bool:
        """One transaction. False where the disk refuses it: nothing of it is there then, and it is tried again later if
        it is to be kept."""
        with self._lock:
            if not self.trouble and self._carry_out([change]):
                return True
            if keep and self.trouble:
                self._waiting.append(change)
            self.changed.set()
            return False

    def retry(self) -> bool:
        """Writes what waits; False where the disk refuses it still."""
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
        connection = self._writer or self._open_writer()
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
        self.close()  # locks of ours on the file end with every descriptor of it that we close
        check_regular(self.path)
        os.close(open_private(self.path, os.O_RDWR))
        try:
            self._writer = self._opened()
        except sqlite3.DatabaseError as error:
            if not _spoilt(error):
                raise
            self._set_aside(str(error))
            self._writer = self._opened()
        self._inode = os.stat(self.path).st_ino
        return self._writer

    def _opened(self) -> sqlite3.Connection:
        connection = sqlite3.connect(self.path, timeout=PATIENCE, isolation_level=None, check_same_thread=False)
        try:
            connection.execute(f"PRAGMA page_size = {PAGE}")
            connection.execute("PRAGMA journal_mode = WAL")
            # The disk is waited for by checkpoints alone: see there.
            connection.execute("PRAGMA wal_autocheckpoint = 0")
            connection.execute("PRAGMA synchronous = OFF")
            version = connection.execute("PRAGMA user_version").fetchone()[0]
            if version > len(STEPS):
                raise _Spoilt(f"it is of version {version}, which a newer rorg wrote")
            for number, step in enumerate(STEPS[version:], version + 1):
                connection.executescript(f"BEGIN IMMEDIATE;{step}PRAGMA user_version = {number};COMMIT;")
            self.generation += not version
        except BaseException:
            connection.close()
            raise
        return connection

    def _set_aside(self, why: str) -> None:
        """Moves the file away. Raises OSError."""
        self.close()
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

    # -- what may wait for the disk ----------------------------------------------------------------------------

    def checkpoint(self) -> None:
        """The disk has all that was written before this was called, unless it refuses."""
        with self._lock:
            if self._writer and not self._in_place():
                self.close()  # somebody took the file away: the next change begins a new one
            if self._writer is None or self.changes == self._done:
                return
            self._checkpoints = self._checkpoints or Checkpoints(self.path, self._quiet)
            upto = self.changes
        if self._use(Checkpoints.make):
            self._done = upto

    def check(self) -> None:
        """Moves the file aside where SQLite finds it damaged."""

        def look(checkpoints: Checkpoints) -> None:
            if found := checkpoints.damage():
                raise _Spoilt(found)

        self._use(look)

    def _use(self, use: Callable[[Checkpoints], None]) -> bool:
        """False where the disk refuses it. It is closed afterwards where the file was closed meanwhile."""
        with self._lock:
            checkpoints, self._at_work = self._checkpoints, True
        try:
            if checkpoints:
                use(checkpoints)
            return True
        except sqlite3.Error as error:
            self.changed.set()
            if _spoilt(error):
                with self._lock, contextlib.suppress(OSError):
                    self._set_aside(str(error))
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
        """What the file answers; nothing where there is none. The owner is answered nothing as well where it cannot be
        read, others are told: raises Invalid."""
        if self.wall is not None:
            self._make()
        try:
            return self._reader.rows(sql, args)
        except FileNotFoundError:
            return []
        except (sqlite3.Error, OSError) as error:
            self._reader.close()
            if self.wall is not None:
                return []
            raise Invalid("read the journal", f"{self.path}: {error}", f"fixing or moving {self.path}") from error

    def _make(self) -> None:
        """Its tables are there, where the disk allows it."""
        with self._lock:
            if self._writer is None and not self.trouble:
                self._carry_out([])

    # -- the end -----------------------------------------------------------------------------------------------

    def close(self) -> None:
        """Until it is used again."""
        with self._lock:
            self._reader.close()
            writer, self._writer = self._writer, None
            checkpoints, self._checkpoints = self._checkpoints, None
            with contextlib.suppress(sqlite3.Error):
                if writer:
                    # The last one that is closed brings everything into the file, and that must be on the disk before
                    # the log goes.
                    writer.execute("PRAGMA synchronous = NORMAL")
                    writer.close()
            if checkpoints and not self._at_work:
                checkpoints.close()


class _Spoilt(sqlite3.DatabaseError):
    """Nothing more can be written to this file."""


def _spoilt(error: Exception) -> bool:
    return isinstance(error, _Spoilt) or (getattr(error, "sqlite_errorcode", 0) & 0xFF) in SPOILT


@contextlib.contextmanager
def reading(path: Path) -> Iterator[Database]:
    """The history in a file, for as long as the block runs."""
    database = Database(path)
    try:
        yield database
    finally:
        database.close()
