"""What wakes the loop. A wake says only that it is worth looking; the two flags say which files to look at."""

from __future__ import annotations

import threading

LONGEST = 3600.0
"""Seconds of sleep at the most: a deadline may be centuries away."""


class Wakes:
    """Every method may be called from any thread but wait(), gather(), clear() and the take_ ones, which are the
    loop's."""

    def __init__(self) -> None:
        self._woken = threading.Event()
        self._urgent = threading.Event()
        """Set with every wake that is not to wait for others."""
        self._files, self._requests = True, True
        """Whether the tree, or the requests file, may have changed."""

    def wake(self) -> None:
        self._urgent.set()
        self._woken.set()

    def wake_soon(self) -> None:
        """For what may be gathered with others of its kind: outcomes, and events of the engine."""
        self._woken.set()

    def files_changed(self) -> None:
        self._files = self._requests = True
        self.wake()

    def requests_changed(self) -> None:
        self._requests = True
        self.wake()

    @property
    def files(self) -> bool:
        return self._files

    def take_files(self) -> bool:
        """Whether the tree may have changed; what comes after this counts for the next time."""
        found, self._files = self._files, False
        return found

    def again(self) -> None:
        """The tree is to be looked at once more, soon."""
        self._files = True

    def take_requests(self) -> bool:
        """The same of the requests file."""
        found, self._requests = self._requests, False
        return found

    def wait(self, seconds: float | None) -> bool:
        """Until something woke the loop, or for so long; whether it was woken."""
        return self._woken.wait(None if seconds is None else min(LONGEST, max(0.0, seconds)))

    def gather(self, seconds: float) -> None:
        """Waits for more, unless something is not to wait, so that one pass sees what comes at about the same time."""
        if self._woken.is_set():
            self._urgent.wait(seconds)

    def woken(self) -> bool:
        return self._woken.is_set()

    def clear(self) -> None:
        self._woken.clear()
        self._urgent.clear()
