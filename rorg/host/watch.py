"""File changes as wakes. What changed is not told: the loop looks at everything anyway."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Collection
from pathlib import Path

import watchfiles

DEBOUNCE = 200
"""Milliseconds of quiet after which a burst of changes is one."""

STEP = 100
"""Milliseconds between two looks of the watcher at what the kernel told it: 10 cost 0.5 % of a core, doing nothing."""


class Watcher:
    """Watches the directories that `folders` names, each by itself and never what a link in them leads to: the kernel
    has few watches, and a link to / would take them all. `folders` is asked anew after every change."""

    def __init__(
        self, folders: Callable[[], Collection[Path]], wake: Callable[[], None], ignore: Callable[[str], bool]
    ) -> None:
        self.folders, self.wake, self.ignore = folders, wake, ignore
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
        """Until there is something else to watch, or a directory is not the one any more that is watched: the kernel
        follows the directory, not its name."""
        folders = self.folders()
        watched, first = _identity(folders), True
        if again:
            self.wake()  # nobody watched meanwhile
        for changes in watchfiles.watch(
            *folders,
            debounce=DEBOUNCE,
            step=STEP,
            stop_event=self._stop,
            rust_timeout=1000,
            watch_filter=lambda _, path: not self.ignore(path),
            raise_interrupt=False,
            yield_on_timeout=True,
            recursive=False,
        ):
            moved = _identity(folders) != watched
            if changes or first:
                self.wake()  # what changed before the kernel was asked to watch is told by nobody
            if moved or ((changes or first) and set(self.folders()) != set(folders)):
                return
            first = False


def _identity(folders: Collection[Path]) -> list[tuple[int, int]]:
    return [(stat.st_dev, stat.st_ino) for stat in (os.stat(path) for path in folders)]
