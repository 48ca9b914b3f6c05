"""Measures how busy the machine is, and which service uses what: psutil, PSI, cgroup files."""

from __future__ import annotations

import contextlib
import os
import threading
from collections.abc import Callable, Mapping
from pathlib import Path

import psutil

from rorg.model.load import Load

PSI = Path("/proc/pressure")
Use = Callable[[], Mapping[str, tuple[float, int]]]
"""Service -> (CPU seconds since it began, bytes)."""


def psi(name: str) -> float:
    """Percent of the last 10 s in which some program waited for cpu, memory or io; 0 if the kernel does not say."""
    try:
        line = (PSI / name).read_text(encoding="ascii").splitlines()[0]
        return float(line.split("avg10=")[1].split()[0])
    except (OSError, IndexError, ValueError):
        return 0.0


def _busy() -> float:
    """CPU seconds that all cores together have worked since the boot."""
    times = psutil.cpu_times()
    return times.user + times.nice + times.system + getattr(times, "irq", 0) + getattr(times, "softirq", 0)


def machine() -> dict[str, float]:
    """The machine now; CPU as seconds since boot, so that any two samples give a rate."""
    memory = psutil.virtual_memory()
    return {
        "cpu_seconds": round(_busy(), 3),
        "cores": os.cpu_count() or 1,
        "memory": memory.total - memory.available,
        "memory_total": memory.total,
        "cpu_some": psi("cpu"),
        "memory_some": psi("memory"),
    }


class Meter:
    """Samples of what `look` returns, by default the machine; rates are since the previous sample."""

    def __init__(self, clock: Callable[[], float], look: Callable[[], Mapping[str, float]] = machine) -> None:
        self.clock, self.look = clock, look
        self._busy: tuple[float, float] | None = None
        self._use: tuple[float, dict[str, tuple[float, int]]] = (0.0, {})

    def sample(self, use: Use | None = None) -> Load:
        """One sample; with `use`, also what each service uses."""
        now, seen = self.clock(), self.look()
        before, self._busy = self._busy, (now, seen["cpu_seconds"])
        cpu = (seen["cpu_seconds"] - before[1]) / (now - before[0]) if before and now > before[0] else 0.0
        return Load(
            now,
            cpu,
            float(seen["cores"]),
            int(seen["memory"]),
            int(seen["memory_total"]),
            seen["cpu_some"],
            seen["memory_some"],
            self._rates(now, use) if use else {},
        )

    def begin(self, use: Use) -> None:
        """Note what each service has used so far, so that the next sample has its rates since now."""
        self._use = (self.clock(), dict(use()))

    def _rates(self, now: float, use: Use) -> dict[str, tuple[float, int]]:
        (then, old), new = self._use, dict(use())
        self._use = (now, new)
        # What has begun since then has no rate yet.
        return {
            n: (max(0.0, cpu - old[n][0]) / max(now - then, 0.001), memory)
            for n, (cpu, memory) in new.items()
            if n in old
        }


class Sampler:
    """Samples every `step()` seconds (None: not at all) in a thread of its own. Only while `matters` says so of a
    sample, it measures services too and wakes the loop."""

    def __init__(
        self,
        meter: Meter,
        step: Callable[[], float | None],
        matters: Callable[[Load], bool],
        use: Use,
        wake: Callable[[], None],
    ) -> None:
        self.meter, self.step, self.matters, self.use, self.wake = meter, step, matters, use, wake
        self.latest: Load | None = None
        self._stop = threading.Event()

    def start(self) -> None:
        threading.Thread(target=self._run, name="sampler", daemon=True).start()

    def stop(self) -> None:
        self._stop.set()

    def _run(self) -> None:
        mattered = False
        while not self._stop.wait(self.step() or 1.0):
            if self.step() is None:
                self.latest, mattered = None, False
                continue
            try:
                self.latest = self.meter.sample(self.use if mattered else None)
            except Exception:  # the engine or the kernel did not answer: the next sample will
                continue
            matters = self.matters(self.latest)
            if matters and not mattered:
                with contextlib.suppress(Exception):
                    self.meter.begin(self.use)
            if matters or mattered:
                self.wake()
            mattered = matters
