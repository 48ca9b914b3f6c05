"""How the programs of services behave in a simulation, drawn from a workload. Each service has a random stream of its
own for each purpose, so that a policy that starts one service more often does not change the others."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from random import Random

from rorg.core.observed import ASLEEP
from rorg.model.catalog import Service
from rorg.model.workload import Behaviour, Distribution, Workload
from rorg.tools.sim.calls import LATENCY

COMES_UP = Distribution((0.1,))
"""Seconds that a program takes to come up, unless the workload says otherwise."""
HOUR = 3600.0


class Programs:
    """Draws the behaviour of programs; the same seed gives exactly the same values."""

    def __init__(self, services: Mapping[str, Service], workload: Workload, seed: int) -> None:
        self.services, self.workload, self.seed = services, workload, seed
        self._streams: dict[tuple[str, str], Random] = {}
        self._measured = {key: iter(seconds) for key, seconds in workload.measured.items()}

    def call(self, verb: str, service: str) -> float:
        """Seconds that a call of the engine takes; `stop` also takes as long as the processes take to end."""
        if (measured := self._next(verb, service)) is not None:
            return measured
        said = self.workload.calls.get(verb)
        taken = LATENCY[verb] if said is None else self._draw(said, service, verb)
        ending = self.workload.of(service).stop if verb == "stop" else None
        return taken + (self._draw(ending, service, "end") if ending else 0.0)

    def start(self, service: str) -> float:
        """Seconds from the start until the program does its work."""
        if (measured := self._next("up", service)) is not None:
            return measured
        said, ready = self.workload.of(service).start, self.services[service].ready
        if said is None and ready is not None and ready.kind == "delay" and ready.delay is not None:
            return ready.delay
        return self._draw(said or COMES_UP, service, "up")

    def resume(self, service: str) -> float:
        """Seconds from the resume until the program does its work again."""
        measured = self._next("again", service)
        return measured if measured is not None else self._draw(self._resume(service), service, "again")

    def life(self, service: str) -> float:
        """Seconds until the program crashes."""
        rate = self.workload.of(service).crashes
        return self._stream(service, "crash").expovariate(rate / HOUR) if rate else inf

    def starting_cores(self, service: str) -> Distribution | None:
        """Cores while the program comes up after a start, if they are known."""
        return self.workload.of(service).cpu_start

    def cores(self, service: str, in_use: bool, starting: bool = False) -> float:
        """Cores that the program wants while it runs."""
        one = self.workload.of(service)
        if starting and one.cpu_start is not None:
            return self._draw(one.cpu_start, service, "cpu")
        active = one.cpu or Distribution((self.services[service].cpu,))
        return self._draw(active if in_use else one.cpu_idle or active, service, "cpu")

    def memory(self, service: str, state: str, in_use: bool) -> float:
        """Bytes in use, running or paused, without what the program has grown by."""
        return self._draw(self._memory(self.workload.of(service), service, state, in_use), service, "memory")

    def growth(self, service: str) -> float:
        """Bytes per second."""
        return self.workload.of(service).growth

    def _memory(self, one: Behaviour, service: str, state: str, in_use: bool) -> Distribution:
        active = one.memory or Distribution((float(self.services[service].memory),))
        if state in ASLEEP:
            return one.memory_paused or one.memory_idle or active
        return active if in_use else one.memory_idle or active

    def _resume(self, service: str) -> Distribution:
        return self.workload.of(service).resume or COMES_UP

    def _next(self, verb: str, service: str) -> float | None:
        """The next measured duration, if there is one."""
        return next(self._measured.get((verb, service), iter(())), None)

    def _draw(self, one: Distribution, service: str, purpose: str) -> float:
        if one.deviation:
            return max(0.0, self._stream(service, purpose).normalvariate(one.mean, one.deviation))
        return one.values[0] if len(one.values) == 1 else self._stream(service, purpose).choice(one.values)

    def _stream(self, service: str, purpose: str) -> Random:
        stream = self._streams.get((service, purpose))
        if stream is None:
            stream = self._streams[service, purpose] = Random(f"{self.seed}/{service}/{purpose}")
        return stream
