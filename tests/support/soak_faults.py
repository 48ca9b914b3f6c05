"""Faults of a long soak: the engine is restarted, and the disk of the state directory is full for a while."""

from __future__ import annotations

import errno
import time
from collections import Counter
from math import inf
from pathlib import Path

from dockerd import Dockerd
from soak import SoakedRorg

FULL = 5.0
"""Seconds for which the disk is full."""
AFTERWARDS = 60.0
"""Seconds after a fault in which a call may still fail because of it."""


class Faults:
    """Causes one fault after another, in turn."""

    def __init__(self, rorg: SoakedRorg, dockerd: Dockerd, every: float) -> None:
        """`every`: seconds from the end of a fault to the next one."""
        self.rorg, self.dockerd, self.every = rorg, dockerd, every
        self.counts: Counter[str] = Counter()
        self._due, self._until = time.monotonic() + every, 0.0

    def excuse(self) -> bool:
        """Whether a call that fails now may have failed because of a fault."""
        return time.monotonic() < self._until

    def cause(self) -> None:
        """Causes the next fault if it is due. To be called in the main thread: the engine ends with the thread that
        started it."""
        if time.monotonic() < self._due:
            return
        fault = (self.restart_engine, self.fill_disk)[self.counts.total() % 2]
        self._until = inf
        fault()
        self.counts[fault.__name__] += 1
        self._until = time.monotonic() + AFTERWARDS
        self._due = time.monotonic() + self.every

    def restart_engine(self) -> None:
        """Every other time it is killed. Its containers end either way."""
        self.dockerd.stop(kill=self.counts["restart_engine"] % 2 == 1)
        self.dockerd.start()

    def fill_disk(self) -> None:
        filler = self.rorg.robot.state.path / "filler"
        try:
            self._write_until_full(filler)
            time.sleep(FULL)
        finally:
            filler.unlink()

    @staticmethod
    def _write_until_full(path: Path) -> None:
        with path.open("wb", buffering=0) as file:
            for size in (1 << 20, 4096):
                try:
                    while True:
                        file.write(bytes(size))
                except OSError as error:
                    if error.errno != errno.ENOSPC:
                        raise
