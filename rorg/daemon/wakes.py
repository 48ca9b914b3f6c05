"""Wakes the loop. A wake only says that a pass is worth it; the two flags say which files to read."""

from __future__ import annotations

import threading

LONGEST = 3600.0
"""Seconds of sleep at most: a deadline may be centuries away."""


class Wakes:
    """Any thread may call these methods, except wait(), gather(), clear() and the take_ ones, which are for the
    loop."""

    def __init__(self) -> None:
        self._woken = threading.Event()
        self._urgent = threading.Event()
        """Set with every wake that must not wait for others."""
        self._files, self._requests, self._check = True, True, False
        """Whether the tree, or the requests file, may have changed; and whether to check that of the tree."""

    def wake(self) -> None:
        self._urgent.set()
        self._woken.set()

    def wake_soon(self) -> None:
        """Wake for something that may be gathered with others: outcomes, and events of the engine."""
        self._woken.set()

    def files_changed(self) -> None:
        self._files = self._requests = True
        self.wake()

    def requests_changed(self) -> None:
        """The tree is checked too: who saves a file and requests its service means what was saved. The watcher tells it
        up to 0.3 s later."""
        self._requests = self._check = True
        self.wake()

    def check_files(self) -> None:
        self._check = True
        self.wake()

    @property
    def files(self) -> bool:
        return self._files

    def take_files(self) -> bool:
        """Whether the tree may have changed; a change after this call counts for the next one."""
        changed, self._files = self._files, False
        return changed

    def take_check(self) -> bool:
        """Whether to check if the tree has changed."""
        check, self._check = self._check, False
        return check

    def again(self) -> None:
        """Look at the tree again soon."""
        self._files = True

    def take_requests(self) -> bool:
        """The same of the requests file."""
        changed, self._requests = self._requests, False
        return changed

    def wait(self, seconds: float | None) -> bool:
        """Wait until something wakes the loop, or so many seconds; return whether it was woken."""
        return self._woken.wait(None if seconds is None else min(LONGEST, max(0.0, seconds)))

    def gather(self, seconds: float) -> None:
        """Wait for more, unless something is urgent, so that one pass handles what happens at about the same time."""
        if self._woken.is_set():
            self._urgent.wait(seconds)

    def woken(self) -> bool:
        return self._woken.is_set()

    def clear(self) -> None:
        self._woken.clear()
        self._urgent.clear()
