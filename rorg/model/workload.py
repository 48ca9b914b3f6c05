"""How services use the machine, frozen: a simulation uses this instead of the programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Distribution:
    """A fixed value, a normal distribution (cut off at 0), or measured values."""

    values: tuple[float, ...]
    deviation: float = 0.0

    @property
    def mean(self) -> float:
        return sum(self.values) / len(self.values)


@dataclass(frozen=True, slots=True)
class Behaviour:
    """The behaviour of one service; None means what its manifest declares (`resources`, `ready`) or the general
    default."""

    cpu: Distribution | None = None
    """Cores while something wants it."""
    cpu_idle: Distribution | None = None
    """Cores while it runs and nothing wants it."""
    cpu_start: Distribution | None = None
    """Cores from its start until it is ready; None: as later."""
    memory: Distribution | None = None
    """Bytes while something wants it."""
    memory_idle: Distribution | None = None
    memory_paused: Distribution | None = None
    start: Distribution | None = None
    """Seconds from the end of the engine's start until it is ready."""
    resume: Distribution | None = None
    """Seconds from the end of the engine's resume until it is ready."""
    stop: Distribution | None = None
    """Seconds that its processes take to end, in addition to the engine's time."""
    growth: float = 0.0
    """Growth of its memory while it runs, in bytes per second."""
    crashes: float = 0.0
    """Crashes per hour of running."""


@dataclass(frozen=True, slots=True)
class Workload:
    """Behaviours by service; `others` is for unlisted ones."""

    name: str = ""
    services: Mapping[str, Behaviour] = field(default_factory=dict)
    others: Behaviour = Behaviour()
    calls: Mapping[str, Distribution] = field(default_factory=dict)
    """Duration of engine calls in seconds, by verb: create, start, pause, resume, stop, remove."""

    probed: bool = False
    """Times of `start` and `resume` last until a probe found the service ready, as `rorg fit` measures them. Otherwise
    they last until the program is up, and its next probe finds that."""
    measured: Mapping[tuple[str, str], tuple[float, ...]] = field(default_factory=dict)
    """(verb, service) -> seconds of its calls in a recorded run, in order. They are replayed first; later calls use
    `calls`. The verbs `up` and `again` are the times from a start and from a resume until ready."""

    def of(self, service: str) -> Behaviour:
        return self.services.get(service, self.others)
