"""What an emulation came to: reductions over its pairs, its agreement with the simulator, and all of it as JSON."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from statistics import mean, median, stdev
from typing import Any

from rorg.sim.agreement import Agreement
from rorg.sim.player import EmulatedRun
from rorg.sim.results import RunResult
from rorg.sim.standins import Share


@dataclass(frozen=True, slots=True)
class Spread:
    """Of one figure over all pairs."""

    mean: float
    least: float
    most: float
    deviation: float
    """The standard deviation; 0 of one value."""

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        return cls(mean(values), min(values), max(values), stdev(values) if len(values) > 1 else 0.0)


@dataclass(frozen=True, slots=True)
class Compared:
    """A run, and how far a simulation of the same trace agrees with it."""

    run: EmulatedRun
    drawn: Agreement
    """Where what calls take is drawn from what was measured."""
    replayed: Agreement
    """Where each call takes what it took."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Emulation:
    """All runs so far: all on and rorg in turns."""

    trace: str
    compress: float
    engine: str
    share: Share
    machine: Mapping[str, float]
    """Of this machine: cores, memory."""
    runs: tuple[Compared, ...]

    def with_run(self, one: Compared) -> Emulation:
        return replace(self, runs=(*self.runs, one))

    @property
    def reductions(self) -> dict[str, Spread]:
        """By which part less was used with rorg: cpu, memory. Nothing before a pair is whole."""
        pairs = list(zip(self.runs[::2], self.runs[1::2], strict=False))
        if not pairs:
            return {}
        return {
            what: Spread.of([_reduction(getattr(a.run.result, what), getattr(b.run.result, what)) for a, b in pairs])
            for what in ("cpu", "memory")
        }


def _reduction(before: float, after: float) -> float:
    return 1 - after / before if before else 0.0


def response_times(result: RunResult) -> dict[str, Any]:
    """Of requests: how many, how many of them were ready in time, and seconds of these; by state of the behaviour."""
    by_state: dict[str, list[float | None]] = {}
    for one in result.responses:
        by_state.setdefault(one.state or one.id, []).append(one.seconds)
    return {state: _times(found) for state, found in sorted(by_state.items())}


def _times(found: Sequence[float | None]) -> dict[str, Any]:
    ready = [seconds for seconds in found if seconds is not None]
    figures = {"median": round(median(ready), 3), "longest": round(max(ready), 3)} if ready else {}
    return {"requests": len(found), "ready": len(ready), **figures}


def as_json(emulation: Emulation) -> dict[str, Any]:
    """Plain values: CPU in cores, memory in bytes, lengths of time in seconds, everything else as fractions."""
    return {
        "trace": emulation.trace,
        "compress": emulation.compress,
        "engine": emulation.engine,
        "scale": asdict(emulation.share),
        "machine": dict(emulation.machine),
        "reductions": {
            what: {k: round(v, 4) for k, v in asdict(s).items()} for what, s in emulation.reductions.items()
        },
        "runs": [_run(one, emulation.share) for one in emulation.runs],
    }


def _run(one: Compared, share: Share) -> dict[str, Any]:
    run, result = one.run, one.run.result
    return {
        "name": result.name,
        "seconds": result.duration,
        "cpu": round(result.cpu, 4),
        "memory": round(result.memory),
        "peak_memory": result.peak_memory,
        "scaled_back": {"cpu": round(result.cpu / share.cpu, 3), "memory": round(result.memory / share.memory)},
        "rorg": {"cpu": round(run.own_cpu, 4), "memory": run.own_memory},
        "load": [round(load, 2) for load in run.load],
        "agreement": {"drawn": _agreement(one.drawn), "replayed": _agreement(one.replayed)},
        "actions": dict(result.actions or {}),
        "calls": {verb: _times(seconds) for verb, seconds in run.calls.items()},
        "responses": response_times(result),
        "violations": [asdict(v) for v in result.violations],
        "samples": {
            "at": [round(s.at, 2) for s in result.samples],
            "cpu": [round(s.cpu, 3) for s in result.samples],
            "memory": [s.memory for s in result.samples],
            "changes": list(_changes(result)),
        },
    }


def _agreement(found: Agreement) -> dict[str, Any]:
    return {
        "moments": found.moments,
        "services": round(found.services, 4),
        "sets": round(found.sets, 4),
        "differing": dict(found.differing),
    }


def _changes(result: RunResult) -> Iterator[dict[str, Any]]:
    """How the active set differs from that of the sample before; the first from nothing."""
    before = frozenset[str]()
    for sample in result.samples:
        if sample.active != before:
            added, removed = sorted(sample.active - before), sorted(before - sample.active)
            yield {"at": round(sample.at, 2), "active": added, "not_active": removed}
        before = sample.active
