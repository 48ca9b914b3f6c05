"""The results of an emulation: its savings, how well it agrees with the simulator, and all of it as JSON."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from statistics import mean, median, stdev
from typing import Any

from rorg.model.catalog import Catalog
from rorg.model.trace import Trace
from rorg.model.workload import Behaviour, Distribution, Workload
from rorg.tools.sim.emulate import Share
from rorg.tools.sim.player import EmulatedRun
from rorg.tools.sim.report import by_state, reduction
from rorg.tools.sim.results import Response, RunResult
from rorg.tools.sim.simulate import simulate

EVERY = 0.05
"""Seconds between two samples of a simulation."""
WARM_UP = 120.0
"""Seconds for the simulated robot to start before the trace begins. An emulation waits for that, too."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """How often two runs agree, as fractions."""

    moments: int
    services: float
    """Over all moments, and all services that were ever active: how often both runs agree on a service."""
    sets: float
    """Over all moments: how often both sets of services are equal."""
    differing: tuple[tuple[str, int], ...]
    """Services with the number of moments at which they differ, largest first."""


def agreement(simulated: RunResult, emulated: RunResult) -> Agreement:
    """Compares each sample of the emulation with the nearest sample of the simulation."""
    if not simulated.samples or not emulated.samples:
        return Agreement(0, 1.0, 1.0, ())
    times = [sample.at for sample in simulated.samples]
    pairs = [(simulated.samples[_nearest(times, s.at)].active, s.active) for s in emulated.samples]
    known = frozenset[str]().union(*(ours | theirs for ours, theirs in pairs))
    counted = Counter(name for ours, theirs in pairs for name in ours ^ theirs)
    compared = len(pairs) * len(known)
    return Agreement(
        len(pairs),
        1 - sum(counted.values()) / compared if compared else 1.0,
        sum(ours == theirs for ours, theirs in pairs) / len(pairs),
        tuple(counted.most_common()),
    )


def _nearest(times: Sequence[float], at: float) -> int:
    """The index of the nearest of these sorted times."""
    after = min(bisect_left(times, at), len(times) - 1)
    return after - 1 if after and at - times[after - 1] < times[after] - at else after


def calibrated(run: EmulatedRun) -> Workload:
    """The measurements of a run by verb and service. A simulation draws from them at random."""
    up, again = ({s: seconds for (verb, s), seconds in run.measured.items() if verb == v} for v in ("up", "again"))
    services = {
        name: Behaviour(
            start=Distribution(up[name]) if name in up else None,
            resume=Distribution(again[name]) if name in again else None,
        )
        for name in {*up, *again}
    }
    calls = {verb: Distribution(seconds) for verb, seconds in run.calls.items()}
    return Workload("measured", services, calls=calls, probed=True)


def simulated(catalog: Catalog, trace: Trace, run: EmulatedRun, workload: Workload, all_on: bool) -> RunResult:
    """The same trace in virtual time, starting when everything is up. Each event has the time at which the emulation
    passed it on, because delays of a busy machine are not rorg's decisions."""
    played = replace(trace, events=run.made).delayed(WARM_UP)
    simulation = simulate(catalog, played, workload, 0, name="simulated", all_on=all_on, every=EVERY)
    samples = tuple(replace(s, at=s.at - WARM_UP) for s in simulation.samples if s.at >= WARM_UP)
    return RunResult("simulated", trace.duration, samples)


def replayed(run: EmulatedRun) -> Workload:
    """The measurements of a run in their order: the n-th call of a verb for a service takes the same time again. The
    remaining differences are those between decisions, and between the times of decisions."""
    return replace(calibrated(run), measured=run.measured)


@dataclass(frozen=True, slots=True)
class Spread:
    """One figure over all pairs."""

    mean: float
    least: float
    most: float
    deviation: float | None
    """The standard deviation; None for a single value."""

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        return cls(mean(values), min(values), max(values), stdev(values) if len(values) > 1 else None)


@dataclass(frozen=True, slots=True)
class Compared:
    """A run, and how well simulations of the same trace agree with it."""

    run: EmulatedRun
    drawn: Agreement
    """With durations drawn at random from the measured ones."""
    replayed: Agreement
    """With the measured duration of each call."""
    simulated: RunResult
    """The simulation for `drawn`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Emulation:
    """All runs so far, alternately with everything on and with rorg."""

    trace: str
    compress: float
    engine: str
    share: Share
    machine: Mapping[str, float]
    """Cores and memory of this machine."""
    runs: tuple[Compared, ...]

    def with_run(self, one: Compared) -> Emulation:
        return replace(self, runs=(*self.runs, one))

    @property
    def reductions(self) -> dict[str, Spread]:
        """The fractions of CPU and memory that rorg saved; empty until a pair is complete, or if a run is not valid."""
        pairs = list(zip(self.runs[::2], self.runs[1::2], strict=False))
        if not pairs or any(one.run.flaws for one in self.runs):
            return {}
        return {
            what: Spread.of([reduction(b.run.result, a.run.result)[what] for a, b in pairs])
            for what in ("cpu", "memory")
        }


def _times(responses: Sequence[Response]) -> dict[str, Any]:
    """Number of requests, how many of them became ready, and after how many seconds."""
    ready = [one.seconds for one in responses if one.seconds is not None]
    return {"requests": len(responses), "ready": len(ready), **_seconds(ready)}


def _seconds(seconds: Sequence[float]) -> dict[str, float]:
    return {"median": round(median(seconds), 3), "longest": round(max(seconds), 3)} if seconds else {}


def as_json(emulation: Emulation) -> dict[str, Any]:
    """Plain values: CPU in cores, memory in bytes, durations in seconds, everything else as fractions."""
    return {
        "trace": emulation.trace,
        "compress": emulation.compress,
        "engine": emulation.engine,
        "scale": asdict(emulation.share),
        "machine": dict(emulation.machine),
        "reductions": {
            what: {k: None if v is None else round(v, 4) for k, v in asdict(s).items()}
            for what, s in emulation.reductions.items()
        },
        "runs": [_run(one, emulation.share) for one in emulation.runs],
    }


def _run(one: Compared, share: Share) -> dict[str, Any]:
    run, result = one.run, one.run.result
    return {
        "name": result.name,
        "invalid": [{"code": flaw.code, "why": flaw.why} for flaw in run.flaws],
        "seconds": result.duration,
        "cpu": round(result.cpu, 4),
        "memory": round(result.memory),
        "peak_memory": result.peak_memory,
        "scaled_back": {"cpu": round(result.cpu / share.cpu, 3), "memory": round(result.memory / share.memory)},
        "simulated": {"cpu": round(one.simulated.cpu, 4), "memory": round(one.simulated.memory)},
        "rorg": {"cpu": round(run.own_cpu, 4), "memory": run.own_memory},
        "load": [round(load, 2) for load in run.load],
        "other_cpu": round(run.conditions.other, 4),
        "stand_ins": {
            name: {"wanted": round(cpu.wanted, 2), "got": round(cpu.got, 2)}
            for name, cpu in sorted(run.conditions.stand_ins.items())
        },
        "agreement": {"drawn": _agreement(one.drawn), "replayed": _agreement(one.replayed)},
        "actions": dict(result.actions or {}),
        "calls": {verb: {"count": len(seconds), **_seconds(seconds)} for verb, seconds in run.calls.items()},
        "responses": {state: _times(those) for state, those in by_state(result.responses).items()},
        "violations": [asdict(v) for v in result.violations],
        "samples": {
            "at": [round(s.at, 2) for s in result.samples],
            "cpu": [round(s.cpu, 3) for s in result.samples],
            "memory": [s.memory for s in result.samples],
            "changes": list(_changes(result)),
        },
    }


def _agreement(agreement: Agreement) -> dict[str, Any]:
    rounded = {"services": round(agreement.services, 4), "sets": round(agreement.sets, 4)}
    return {"moments": agreement.moments, **rounded, "differing": dict(agreement.differing)}


def _changes(result: RunResult) -> Iterator[dict[str, Any]]:
    """Changes of the active set from sample to sample. The first one is relative to the empty set."""
    before = frozenset[str]()
    for sample in result.samples:
        if sample.active != before:
            added, removed = sorted(sample.active - before), sorted(before - sample.active)
            yield {"at": round(sample.at, 2), "active": added, "not_active": removed}
        before = sample.active
