"""Measures the CPU and memory of containers, of this process, and of everything else on the machine."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from rorg.core.observed import Container
from rorg.engines.protocol import Usage
from rorg.host.load import machine
from rorg.tools.sim.validity import Cpu

PAGE = os.sysconf("SC_PAGE_SIZE")


class ServicesMeter:
    """Measures CPU and memory of containers, from the engine's counters (control groups, if it has any). What a
    container used between the last look and its end is lost, so look often. `cores`: what each service should use
    while it runs."""

    def __init__(
        self, usage: Callable[[tuple[Container, ...]], Mapping[str, Usage]], cores: Mapping[str, float]
    ) -> None:
        self._usage, self._cores = usage, cores
        self._before: dict[str, float] | None = None
        self._at = 0.0
        self._steady: dict[str, tuple[str, Cpu]] = {}
        """Run -> its service and CPU between the last two looks, in both of which it ran."""
        self.cpu_seconds = 0.0
        """CPU seconds since the first look."""
        self.memory = 0
        """Bytes at the last look."""
        self.stand_ins: dict[str, Cpu] = {}
        """Service -> what it wanted and got while it ran."""

    def look(self, containers: tuple[Container, ...]) -> None:
        at, usage_by_id = time.monotonic(), self._usage(containers)
        running = {f"{c.id} {c.started_at}": c for c in containers if c.state == "running" and c.id in usage_by_id}
        now = {f"{c.id} {c.started_at}": usage_by_id[c.id].cpu for c in containers if c.id in usage_by_id}
        if self._before is not None:
            before = self._before
            self.cpu_seconds += sum(max(0.0, cpu - before.get(run, 0.0)) for run, cpu in now.items())
            self._count(running, now, at - self._at)
        self._before, self._at = now, at
        self.memory = sum(use.memory for use in usage_by_id.values())

    def _count(self, running: Mapping[str, Container], now: Mapping[str, float], seconds: float) -> None:
        """Counts the time before the last look for runs that go on. The snapshot of containers can be older than the
        end of one, so the last time before an end does not count."""
        for run, (service, cpu) in self._steady.items():
            if run in running:
                self.stand_ins[service] = self.stand_ins.get(service, Cpu()) + cpu
        before = self._before or {}
        self._steady = {
            run: (c.service, Cpu(self._cores.get(c.service, 0.0) * seconds, now[run] - before[run]))
            for run, c in running.items()
            if run in before
        }


class OwnMeter:
    """Measures CPU and memory of this process, which runs the loop, without the CPU of the measuring thread; and the
    CPU of other programs."""

    def __init__(self) -> None:
        self._cpu, self._at = self._used(), time.monotonic()
        self._all, self._machine = time.process_time(), machine()["cpu_seconds"]

    def cores(self) -> float:
        """Mean number of cores since it was made."""
        return (self._used() - self._cpu) / (time.monotonic() - self._at)

    def other_cores(self, services: float) -> float:
        """Mean number of cores that neither this process nor the services used. `services`: their CPU seconds."""
        own = time.process_time() - self._all
        return max(0.0, machine()["cpu_seconds"] - self._machine - own - services) / (time.monotonic() - self._at)

    @staticmethod
    def memory() -> int:
        """Resident memory in bytes."""
        return int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1]) * PAGE

    @staticmethod
    def _used() -> float:
        return time.process_time() - time.thread_time()
