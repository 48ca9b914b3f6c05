"""Turns file changes into wakes, which name what changed as far as that is known."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Collection
from pathlib import Path

import watchfiles

DEBOUNCE = 200
"""Milliseconds without changes that end a burst."""

STEP = 100
"""Milliseconds between two checks of the kernel's events: 10 take 0.5 % of a core, even if nothing happens."""


class Watcher:
    """Watches the directories that `folders` returns, each one alone, without following links: the kernel has few
    watches, and a link to / would use all of them. `folders` is called again after every change. `wake` gets the paths
    that changed, none if anything may have."""

    def __init__(
        self,
        folders: Callable[[], Collection[Path]],
        wake: Callable[[Collection[str]], None],
        ignore: Callable[[str], bool],
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
                # The directory is being replaced; it comes back, or the loop reports that it is gone.
                self._stop.wait(0.2)
            again = True

    def _follow(self, again: bool) -> None:
        """Watch until the set of directories changes, or one of them is replaced: the kernel watches the directory, not
        its name."""
        folders = self.folders()
        watched, first = _identity(folders), True
        if again:
            self.wake(())  # there was no watch meanwhile
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
                # Changes before the watch began are not reported.
                self.wake(() if first or moved else {path for _, path in changes})
            if moved or ((changes or first) and set(self.folders()) != set(folders)):
                return
            first = False


def _identity(folders: Collection[Path]) -> list[tuple[int, int]]:
    return [(stat.st_dev, stat.st_ino) for stat in (os.stat(path) for path in folders)]
