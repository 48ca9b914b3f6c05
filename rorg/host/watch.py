"""File changes as wakes. What changed is not told: the loop looks at everything anyway."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from pathlib import Path

import watchfiles

DEBOUNCE = 200
"""Milliseconds of quiet after which a burst of changes is one."""

STEP = 100
"""Milliseconds between two looks of the watcher at what the kernel told it: 10 cost 0.5 % of a core, doing nothing."""


class Watcher:
    """Wakes the loop when something changes below these paths."""

    def __init__(self, paths: list[Path], wake: Callable[[], None], ignore: Callable[[str], bool]) -> None:
        self.paths, self.wake, self.ignore = paths, wake, ignore
        self._stop = threading.Event()

    def start(self) -> None:
        threading.Thread(target=self._run, name="watch", daemon=True).start()

    def stop(self) -> None:
        self._stop.set()

    def _run(self) -> None:
        again = False
        while not self._stop.is_set():
            try:
                self._follow(again)
            except Exception:
                # The directory is being replaced; it comes back, or the loop says that it is gone.
                self._stop.wait(0.2)
            again = True

    def _follow(self, again: bool) -> None:
        """Until one of the directories is not the one any more that is watched: the kernel follows the directory, not
        its name."""
        watched, first = self._identity(), True
        if again:
            self.wake()  # nobody watched meanwhile
        for changes in watchfiles.watch(
            *self.paths,
            debounce=DEBOUNCE,
            step=STEP,
            stop_event=self._stop,
            rust_timeout=1000,
            watch_filter=lambda _, path: not self.ignore(path),
            raise_interrupt=False,
            yield_on_timeout=True,
        ):
            moved = self._identity() != watched
            if changes or first:
                self.wake()  # what changed before the kernel was asked to watch is told by nobody
            first = False
            if moved:
                return

    def _identity(self) -> list[tuple[int, int]]:
        return [(stat.st_dev, stat.st_ino) for stat in (os.stat(path) for path in self.paths)]
