"""The thread for slow work on the history: it waits for the disk, tries again what the disk refused, and removes old
entries."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from rorg.history.database import Database
from rorg.history.journal import Journal
from rorg.history.retention import Retention, trim
from rorg.model.units import parse_time, stamp

EVERY = 1.0
"""Seconds from a change until the disk has it, and between two attempts to write what it refused."""
TRIM = 1000
"""Changes after which old entries are looked for."""
REST = 0.005
"""Seconds between two batches of removals."""
DAY = 86_400.0


class Maintenance:
    """`tell` gets the kind and the message of events about the file; `wall` gives seconds since the epoch, `clock`
    those of the monotonic clock."""

    def __init__(
        self,
        database: Database,
        tell: Callable[[str, str], None],
        retention: Callable[[], Retention],
        wall: Callable[[], float],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.database, self.tell, self.retention, self.wall, self.clock = database, tell, retention, wall, clock
        self._newest, self._began = _newest(database, wall()), clock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="history", daemon=True)
        self._trimmed: int | None = None
        """The number of changes at the last removal of old entries."""

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()
        self.database.changed.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._stop.is_set():
            self.database.changed.wait()
            self._stop.wait(EVERY)
            self.look()

    def _rest(self) -> None:
        self._stop.wait(REST)

    def _present(self) -> float:
        """The time that ages are counted from, in seconds since the epoch. It is at most as long after the newest entry
        of the last rorg as this one has run: a clock that is set to 2076 makes no entry old."""
        return min(self.wall(), self._newest + self.clock() - self._began)

    def look(self) -> None:
        """Do what there is to do."""
        self.database.changed.clear()
        self.database.retry()
        self.database.checkpoint()
        if self._trimmed is None:
            self.database.check()
            Journal(self.database).check(self._rest)
        if self._trimmed is None or self.database.changes - self._trimmed >= TRIM:
            retention = self.retention()
            trim(self.database, retention, stamp(max(0.0, self._present() - retention.days * DAY)), self._rest)
            self._trimmed = self.database.changes
        for kind, message in self.database.take_notes():
            self.tell(kind, message)


def _newest(database: Database, otherwise: float) -> float:
    """The time of the newest entry, in seconds since the epoch. A damaged one is found by the check."""
    newest = next((at for (at,) in database.rows("SELECT max(at) FROM entry")), None)
    try:
        return parse_time(newest)
    except (ValueError, TypeError):
        return otherwise
