"""Removes from /dev/shm what dead ROS 2 participants left: 0.6 MB each, which nothing else frees. Only if the Policy
says so, because a file does not show whether a container of this robot made it."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable
from pathlib import Path

from rorg.core.shared_memory import group_of, none_runs, participants
from rorg.core.situation import Situation
from rorg.host.shared_memory import SHM, Removed, remove_unused
from rorg.model.catalog import Catalog


class ShmPurger:
    """Looks, in a thread of its own, at the beginning and whenever the last participant of this robot has ended. `tell`
    is called with what was removed; `wall` gives seconds since the epoch."""

    def __init__(
        self, tell: Callable[[Removed], None], wall: Callable[[], float] = time.time, folder: Path = SHM
    ) -> None:
        self.tell, self.wall, self.folder = tell, wall, folder
        self._catalog: Catalog | None = None
        self._participants: frozenset[str] = frozenset()
        """The participants in that catalog."""
        self._quiet = False
        """Whether no participant ran at the last pass."""
        self._lock = threading.Lock()

    def look(self, situation: Situation) -> None:
        """Notice that no participant runs any more."""
        catalog = situation.desired.catalog
        if catalog is not self._catalog:
            self._catalog, self._participants = catalog, participants(catalog.services)
        quiet = (
            catalog.policy.purge_shm
            and bool(self._participants)
            and none_runs(self._participants, catalog.services, situation.observed)
        )
        if quiet and not self._quiet:
            threading.Thread(target=self._purge, args=(self.wall(),), name="shm-purger", daemon=True).start()
        self._quiet = quiet

    def _purge(self, ended: float) -> None:
        with self._lock, contextlib.suppress(OSError):  # without root's rights it is not known which files others use
            removed = remove_unused(self.folder, group_of, ended)
            if removed.files:
                self.tell(removed)
