"""How far a simulation and an emulation agree on which services are active, moment by moment."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

from rorg.model.catalog import Catalog
from rorg.model.trace import Trace
from rorg.model.workload import Behaviour, Distribution, Workload
from rorg.sim.player import EmulatedRun
from rorg.sim.results import RunResult
from rorg.sim.simulate import simulate

EVERY = 1.0
"""Seconds between two moments."""
WARM_UP = 120.0
"""Seconds for which a simulated robot comes up before the trace begins: an emulation begins when that is over."""


@dataclass(frozen=True, slots=True)
class Agreement:
    """Fractions, of what was compared."""

    moments: int
    services: float
    """Of all moments and services that were active at any of them: how often both say the same."""
    sets: float
    """Of all moments: how often the whole sets are equal."""
    differing: tuple[tuple[str, int], ...]
    """Services with the number of moments at which they differ, most of them first."""


def agreement(simulated: RunResult, emulated: RunResult) -> Agreement:
    """Compares the samples nearest to each full EVERY seconds."""
    ours, theirs = (_by_moment(run) for run in (simulated, emulated))
    moments = sorted(ours.keys() & theirs.keys())
    known = frozenset[str]().union(*(ours[m] | theirs[m] for m in moments))
    counted = Counter(name for moment in moments for name in ours[moment] ^ theirs[moment])
    pairs = len(moments) * len(known)
    return Agreement(
        len(moments),
        1 - sum(counted.values()) / pairs if pairs else 1.0,
        sum(ours[m] == theirs[m] for m in moments) / len(moments) if moments else 1.0,
        tuple(counted.most_common()),
    )


def _by_moment(run: RunResult) -> dict[int, frozenset[str]]:
    return {round(sample.at / EVERY): sample.active for sample in run.samples}


def calibrated(run: EmulatedRun) -> Workload:
    """What calls of the engine took in a run, and how long services took to be ready: a simulation of the same trace
    is given what was measured, and no more."""
    services = {
        name: Behaviour(
            start=Distribution(run.starts[name]) if name in run.starts else None,
            resume=Distribution(run.resumes[name]) if name in run.resumes else None,
        )
        for name in {*run.starts, *run.resumes}
    }
    return Workload("measured", services, calls={verb: Distribution(seconds) for verb, seconds in run.calls.items()})


def simulated(catalog: Catalog, trace: Trace, run: EmulatedRun, all_on: bool, seed: int = 0) -> RunResult:
    """The same trace in virtual time, calibrated by a run of its emulation, from the moment at which all is up."""
    found = simulate(
        catalog, trace.delayed(WARM_UP), calibrated(run), seed, name="simulated", all_on=all_on, every=EVERY
    )
    samples = tuple(replace(s, at=s.at - WARM_UP) for s in found.samples if s.at > WARM_UP)
    return replace(found, duration=trace.duration, samples=samples, responses=(), violations=(), cpu_seconds=None)
