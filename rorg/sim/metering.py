"""What services use, and what rorg itself uses, measured over a run."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from rorg.core.observed import Container
from rorg.engines.protocol import Usage

PAGE = os.sysconf("SC_PAGE_SIZE")


class ServicesMeter:
    """CPU and memory of containers from what the engine says of each since it began (control groups, where it has
    any). What a container used between the last look and its end is lost: look often."""

    def __init__(self, usage: Callable[[tuple[Container, ...]], Mapping[str, Usage]]) -> None:
        self._usage = usage
        self._before: dict[str, float] | None = None
        self.cpu_seconds = 0.0
        """Since the first look."""
        self.memory = 0
        """Bytes at the last look."""

    def look(self, containers: tuple[Container, ...]) -> None:
        found = self._usage(containers)
        now = {f"{c.id} {c.started_at}": found[c.id] for c in containers if c.id in found}
        if self._before is not None:
            before = self._before
            self.cpu_seconds += sum(max(0.0, use.cpu - before.get(run, 0.0)) for run, use in now.items())
        self._before = {run: use.cpu for run, use in now.items()}
        self.memory = sum(use.memory for use in now.values())


class OwnMeter:
    """CPU and memory of this process, which has the loop; the CPU without the thread that measures."""

    def __init__(self) -> None:
        self._cpu, self._at = self._used(), time.monotonic()

    def cores(self) -> float:
        """In the mean since it was made."""
        return (self._used() - self._cpu) / (time.monotonic() - self._at)

    @staticmethod
    def memory() -> int:
        """Bytes that are resident now."""
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * PAGE

    @staticmethod
    def _used() -> float:
        return time.process_time() - time.thread_time()
