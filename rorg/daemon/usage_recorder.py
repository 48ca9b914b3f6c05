"""Measures what services use while they run: once a minute, and before a pause or stop. And the machine, once a
minute."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Mapping, Sequence

from rorg.core.observed import Container
from rorg.engines.protocol import Usage
from rorg.history.usage import MACHINE, Measured, UsageTable

EVERY = 60.0
"""Seconds between two looks at all."""
LEAST = 0.5
"""Seconds below which nothing is concluded: a run that has just been noticed used CPU before that."""
Alive = Sequence[tuple[Container, float | None]]
"""Containers that have not ended, each with the time since when it runs, by the clock; None while it is paused."""


class UsageRecorder:
    """Works in a thread of its own. `alive` returns what has not ended, `usage` what that has used since it began; the
    engine is not asked while nothing runs. `machine`: CPU seconds and bytes of the machine; None if the engine is on
    another one. `began` is the time of day (ISO 8601) at which this rorg began: older runs are measured only from the
    first look on. `clock` gives seconds, `wall` the time of day."""

    def __init__(
        self,
        table: UsageTable,
        alive: Callable[[], Alive],
        usage: Callable[[Sequence[Container]], Mapping[str, Usage]],
        clock: Callable[[], float],
        wall: Callable[[], str],
        machine: Callable[[], Mapping[str, float]] | None = None,
    ) -> None:
        self.table, self.alive, self.usage, self.clock, self.wall = table, alive, usage, clock, wall
        self.machine = machine
        self.began = wall()
        self._seen: dict[str, tuple[float, float]] = {}
        """Incarnation -> (when, its CPU seconds then)."""
        self._machine: tuple[float, float] | None = None
        """The same of the machine."""
        self._lock, self._stop = threading.Lock(), threading.Event()

    def start(self) -> None:
        if self.machine:
            self._whole(self.clock(), self.machine())
        threading.Thread(target=self._run, name="usage", daemon=True).start()

    def stop(self) -> None:
        self._stop.set()

    def _run(self) -> None:
        while not self._stop.wait(EVERY):
            self.look()

    def look(self, service: str = "") -> None:
        """Measure everything that runs, or one service. If the engine does not answer, the next look asks again."""
        with self._lock, contextlib.suppress(Exception):
            everything = self.alive()
            if not service:
                runs = {c.incarnation for c, _ in everything}
                self._seen = {run: seen for run, seen in self._seen.items() if run in runs}
            containers = [(c, at) for c, at in everything if at is not None and service in ("", c.service)]
            usage = self.usage([c for c, _ in containers]) if containers else {}
            now = self.clock()
            measured = [self._one(c, since, now, usage[c.id]) for c, since in containers if c.id in usage]
            whole = [] if service or self.machine is None else [self._whole(now, self.machine())]
            self.table.note(self.wall(), [m for m in (*whole, *measured) if m])

    def _whole(self, now: float, used: Mapping[str, float]) -> Measured | None:
        before, self._machine = self._machine, (now, used["cpu_seconds"])
        if before is None or now <= before[0]:
            return None
        cpu = max(0.0, used["cpu_seconds"] - before[1])
        return Measured(MACHINE, "", now - before[0], cpu, int(used["memory"]))

    def _one(self, container: Container, since: float, now: float, used: Usage) -> Measured | None:
        run = container.incarnation
        if run not in self._seen and container.started_at < self.began:
            self._seen[run] = now, used.cpu
            return None
        at, cpu = self._seen.get(run, (since, 0.0))
        seconds = now - max(at, since)
        if seconds < LEAST:
            return None
        self._seen[run] = now, used.cpu
        return Measured(container.service, run, seconds, max(0.0, used.cpu - cpu), used.memory)
