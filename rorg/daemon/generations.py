"""Generations: the numbers of accepted changes, and how far the loop has acted on them."""

from __future__ import annotations

import threading


class Generations:
    """Every accepted change gets the next number. The first one is the time of day in milliseconds: so all numbers of
    an earlier rorg are lower, and this one has read everything at its start. A higher number is of an earlier rorg too:
    then the clock was set back."""

    def __init__(self, start: int) -> None:
        self._lock = threading.Lock()
        self._files: list[int] = []
        """Changes of manifests that the loop has not read yet."""
        self.latest = start
        """The number of the last change, whose file is in its place before it counts here."""
        self.acted = start - 1
        """All changes up to this one are in the loop's last decision."""

    def changed(self, manifest: bool = False) -> int:
        """Return the number of a change whose file is in its place now."""
        with self._lock:
            self.latest += 1
            if manifest:
                self._files.append(self.latest)
            return self.latest

    def begin(self) -> int:
        """Call this before the loop reads: everything accepted until then will be read."""
        with self._lock:
            return self.latest

    def read(self, upto: int, manifests: bool) -> int:
        """How far a decision has come that read all changes up to one; without `manifests` the tree could not be read
        yet."""
        with self._lock:
            if manifests:
                self._files = [n for n in self._files if n > upto]
            return min([upto, *(n - 1 for n in self._files)])

    def reached(self, generation: int) -> bool:
        """Whether the loop's last decision includes a change."""
        with self._lock:
            return generation <= self.acted or generation > self.latest
