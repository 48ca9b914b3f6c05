"""Generations: numbers of the changes that were accepted, and how far the loop has acted on them."""

from __future__ import annotations

import threading


class Generations:
    """Every accepted change gets the next number. They begin at the time of day in milliseconds, so that a number that
    an earlier rorg gave out is behind all of this one's, which has read everything at its start; one that is ahead
    (the clock was set back) is of an earlier rorg too."""

    def __init__(self, start: int) -> None:
        self._lock = threading.Lock()
        self._files: list[int] = []
        """Changes of manifests that the loop has not read yet."""
        self.latest = start
        """Of the last change; whatever counts is on the disk before it counts here."""
        self.acted = start - 1
        """All changes up to this one are in the loop's last decision."""

    def changed(self, manifest: bool = False) -> int:
        """The number of a change that is on the disk now."""
        with self._lock:
            self.latest += 1
            if manifest:
                self._files.append(self.latest)
            return self.latest

    def begin(self) -> int:
        """To be called before the loop reads: what was accepted until then is read."""
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
        """Whether the loop's last decision knows of a change."""
        with self._lock:
            return generation <= self.acted or generation > self.latest
