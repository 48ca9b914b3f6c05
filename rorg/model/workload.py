"""How services use the machine, frozen: what a simulation takes for the programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Distribution:
    """One value (fixed), values around a mean (normal, never below 0), or one of those that were measured
    (empirical)."""

    values: tuple[float, ...]
    deviation: float = 0.0

    @property
    def mean(self) -> float:
        return sum(self.values) / len(self.values)


@dataclass(frozen=True, slots=True)
class Behaviour:
    """Of one service; None for what its manifest says (`resources`, `ready`), or what holds for all."""

    cpu: Distribution | None = None
    """Cores while it does what it was requested for."""
    cpu_idle: Distribution | None = None
    """Cores while it runs and nothing wants it."""
    memory: Distribution | None = None
    """Bytes, likewise."""
    memory_idle: Distribution | None = None
    memory_paused: Distribution | None = None
    start: Distribution | None = None
    """Seconds from the end of the engine's start until it is ready."""
    resume: Distribution | None = None
    """Seconds from the end of the engine's resume until it is ready."""
    stop: Distribution | None = None
    """Seconds that its processes take to end, beside what the engine takes."""
    growth: float = 0.0
    """Bytes per second that its memory grows while it runs."""
    crashes: float = 0.0
    """Per hour in which it runs."""


@dataclass(frozen=True, slots=True)
class Workload:
    """Behaviours by service; `others` for those that are not named."""

    name: str = ""
    services: Mapping[str, Behaviour] = field(default_factory=dict)
    others: Behaviour = Behaviour()
    calls: Mapping[str, Distribution] = field(default_factory=dict)
    """Seconds that a call of the engine takes, by verb: create, start, pause, resume, stop, remove."""

    measured: Mapping[tuple[str, str], tuple[float, ...]] = field(default_factory=dict)
    """(verb, service) -> seconds that its calls took in a run, in their order: they take the same again, and what comes
    after them goes by `calls`. `up` and `again` for verbs: from a start, and a resume, until it was ready."""

    def of(self, service: str) -> Behaviour:
        return self.services.get(service, self.others)
