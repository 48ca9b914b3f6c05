"""Keeps what the loop learns about requests over its restarts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rorg.core.prediction import learn
from rorg.errors import Missing
from rorg.history.journal import Journal
from rorg.history.request_log import RequestLog
from rorg.model.learned import Learned
from rorg.model.trace import TraceEvent
from rorg.model.units import parse_time, stamp
from rorg.store.learned_file import read_learned, write_learned

EVERY = 60.0
"""Seconds between two writes, at least."""
BACK = 30 * 86_400.0
"""Seconds of the journal that are read if no file exists."""


class Learner:
    """Uses the file of a state directory; if there is none, the requests in the journal. `clock` gives monotonic
    seconds, `now` is the time of day."""

    def __init__(self, folder: Path, journal: Journal, clock: Callable[[], float], now: float) -> None:
        self.folder, self.clock = folder, clock
        self.learned = read_learned(folder) or learnt_from(journal, now)
        """What the loop begins with."""
        self._written, self._last = self.learned, self.learned
        self._at = clock()

    def note(self, learned: Learned) -> None:
        """Note what is known after a pass."""
        self._last = learned
        if self._last is not self._written and self.clock() - self._at >= EVERY:
            self.write()

    def write(self) -> None:
        """Write what is new. If the disk is full, the next write has it too."""
        self._at = self.clock()
        if self._last is self._written:
            return
        try:
            write_learned(self.folder, self._last)
        except OSError:
            return
        self._written = self._last


def learnt_from(journal: Journal, now: float) -> Learned:
    """The requests in the journal before `now`, seconds since the epoch."""
    try:
        trace = RequestLog(journal).between(stamp(now - BACK), stamp(now))
    except Missing:
        return Learned()
    begin = parse_time(trace["begin"])
    return learn(
        TraceEvent(parse_time(r["at"]) - begin, r["requester"], r["id"], tuple(r["services"]))
        for r in trace["requests"]
    )
