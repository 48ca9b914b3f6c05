"""Keeps what the loop learns of requests over its restarts."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from rorg.model.learned import Learned
from rorg.store.learned_file import read_learned, write_learned

EVERY = 60.0
"""Seconds between two writes, at the least."""


class Learner:
    """Over the file of a state directory. `clock` gives monotonic seconds."""

    def __init__(self, folder: Path, clock: Callable[[], float]) -> None:
        self.folder, self.clock = folder, clock
        self.learned = read_learned(folder) or Learned()
        """What the loop begins with."""
        self._written, self._last = self.learned, self.learned
        self._at = clock()

    def note(self, learned: Learned) -> None:
        """What is known after a pass."""
        self._last = learned
        if self._last is not self._written and self.clock() - self._at >= EVERY:
            self.write()

    def write(self) -> None:
        """A full disk loses what is new; it is written with what comes next."""
        self._at = self.clock()
        if self._last is self._written:
            return
        try:
            write_learned(self.folder, self._last)
        except OSError:
            return
        self._written = self._last
