"""What variants of a robot cost in CPU, memory and waiting, and which of them are efficient."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from statistics import fmean, median
from typing import Any, NamedTuple

from rorg.sim.results import Response, RunResult
from rorg.sim.variants import Variant


class Cost(NamedTuple):
    """Means over a run."""

    cpu: float
    """Cores."""
    memory: float
    """Bytes."""
    waiting: float
    """Seconds until a request is ready."""


@dataclass(frozen=True, slots=True)
class Tried:
    """A variant and its results. Only requests that take time with at least one variant count. Requests for services
    that are always on would hide the differences."""

    variant: Variant
    result: RunResult
    waits: tuple[float, ...]
    """Seconds, in order, of requests that became ready."""
    unready: int
    """Requests that were released before they were ready."""
    efficient: bool = False
    """No other variant costs less of something and no more of anything (Pareto)."""

    @property
    def cost(self) -> Cost:
        return Cost(self.result.cpu, self.result.memory, fmean(self.waits) if self.waits else 0.0)

    def as_json(self) -> dict[str, Any]:
        times = sorted(self.waits) or [0.0]
        return {
            "run": self.variant.name,
            "settings": dict(self.variant.settings),
            "cpu": round(self.result.cpu, 4),
            "memory": round(self.result.memory),
            "peak_memory": self.result.peak_memory,
            "requests": len(self.waits) + self.unready,
            "response_mean": round(self.cost.waiting, 4),
            "response_median": round(median(times), 4),
            "response_p95": round(times[ceil(0.95 * len(times)) - 1], 4),
            "unready": self.unready,
            "violations": len(self.result.violations),
            "calls": sum((self.result.actions or {}).values()),
            "efficient": self.efficient,
        }


def tried(variants: Sequence[Variant], results: Sequence[RunResult]) -> list[Tried]:
    """In the order of the variants. All results are of the same trace."""
    each = list(zip(*(result.responses for result in results), strict=True))
    counted = [index for index, responses in enumerate(each) if any(r.seconds != 0 for r in responses)]
    return _marked([_tried(v, r, [r.responses[i] for i in counted]) for v, r in zip(variants, results, strict=True)])


def _tried(variant: Variant, result: RunResult, responses: Sequence[Response]) -> Tried:
    waits = tuple(r.seconds for r in responses if r.seconds is not None)
    return Tried(variant, result, waits, len(responses) - len(waits))


def _marked(found: Sequence[Tried]) -> list[Tried]:
    costs = [one.cost for one in found]
    return [
        Tried(one.variant, one.result, one.waits, one.unready, not any(_beats(other, one.cost) for other in costs))
        for one in found
    ]


def _beats(one: Cost, other: Cost) -> bool:
    return one != other and all(mine <= its for mine, its in zip(one, other, strict=True))
