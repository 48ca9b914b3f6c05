"""What a run of a trace came to, frozen: the same for a simulation and for an emulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Sample:
    """The machine at one time."""

    at: float
    """Seconds since the trace began."""
    cpu: float
    """Cores, in the mean since the sample before."""
    memory: int
    """Bytes, at this time."""
    active: frozenset[str]
    """Services that run."""
    paused: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Response:
    """How long something that was requested took to be ready, all of it."""

    at: float
    requester: str
    id: str
    state: str
    """The state of the behaviour that requested it; empty for a request by itself."""
    seconds: float | None
    """None where it was released before, or never ready."""


@dataclass(frozen=True, slots=True)
class Violation:
    """Something that should not be: `code` is stable."""

    at: float
    code: str
    """invariant, unready (wanted, was ready, and is not any more), late, refused, over_budget."""
    service: str
    text: str


@dataclass(frozen=True, slots=True)
class RunResult:
    """One run of a trace over one robot."""

    name: str
    """What was tried, such as "rorg", "all on" or a policy."""
    duration: float
    samples: tuple[Sample, ...]
    responses: tuple[Response, ...] = ()
    violations: tuple[Violation, ...] = ()
    actions: Mapping[str, int] | None = None
    """Verb -> how many calls of the engine."""
    cpu_seconds: float | None = None
    """Core seconds over the run, where they were added up; else the samples tell."""
    byte_seconds: float | None = None
    """Bytes times seconds, likewise."""

    @property
    def cpu(self) -> float:
        """Cores, in the mean over the run."""
        if self.cpu_seconds is not None:
            return self.cpu_seconds / self.duration
        return self._mean([s.cpu for s in self.samples])

    @property
    def memory(self) -> float:
        """Bytes, in the mean over the run."""
        if self.byte_seconds is not None:
            return self.byte_seconds / self.duration
        return self._mean([float(s.memory) for s in self.samples])

    @property
    def peak_memory(self) -> int:
        return max((s.memory for s in self.samples), default=0)

    @staticmethod
    def _mean(values: list[float]) -> float:
        return sum(values) / len(values) if values else 0.0
