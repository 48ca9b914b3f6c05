"""How far a simulation and an emulation agree on which services are active, moment by moment."""

from __future__ import annotations

from bisect import bisect_left
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from rorg.model.catalog import Catalog
from rorg.model.trace import Trace
from rorg.model.workload import Behaviour, Distribution, Workload
from rorg.sim.player import EmulatedRun
from rorg.sim.results import RunResult
from rorg.sim.simulate import simulate

EVERY = 0.05
"""Seconds between two samples of a simulation."""
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
    """Compares each sample of the emulation with what is simulated for that time: the sample nearest to it."""
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
    """The place of the one of these, in their order, that is nearest."""
    after = min(bisect_left(times, at), len(times) - 1)
    return after - 1 if after and at - times[after - 1] < times[after] - at else after


def calibrated(run: EmulatedRun) -> Workload:
    """What was measured in a run, by verb and by service, without its order: a simulation draws from it."""
    up, again = ({s: seconds for (verb, s), seconds in run.measured.items() if verb == v} for v in ("up", "again"))
    services = {
        name: Behaviour(
            start=Distribution(up[name]) if name in up else None,
            resume=Distribution(again[name]) if name in again else None,
        )
        for name in {*up, *again}
    }
    return Workload("measured", services, calls={verb: Distribution(seconds) for verb, seconds in run.calls.items()})


def simulated(catalog: Catalog, trace: Trace, run: EmulatedRun, workload: Workload, all_on: bool) -> RunResult:
    """The same trace in virtual time, from the moment at which all is up. Each event is at the time at which the
    emulation passed it on: how busy the machine was is no decision of rorg's."""
    played = replace(trace, events=run.made).delayed(WARM_UP)
    found = simulate(catalog, played, workload, 0, name="simulated", all_on=all_on, every=EVERY)
    samples = tuple(replace(s, at=s.at - WARM_UP) for s in found.samples if s.at >= WARM_UP)
    return RunResult("simulated", trace.duration, samples)


def replayed(run: EmulatedRun) -> Workload:
    """The same in its order: the n-th call of a verb for a service takes what it took. What is left of differences are
    those of decisions, and of when they are made."""
    return replace(calibrated(run), measured=run.measured)
