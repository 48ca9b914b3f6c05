"""One pass of the loop as a pure function: everything that was read goes in, everything to do comes out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from operator import itemgetter

from rorg.core.assessment import assess
from rorg.core.check import check
from rorg.core.desired import Desired
from rorg.core.dispatch import begin, forget, freed_at, select
from rorg.core.holds import seconds_left
from rorg.core.incremental import Planned, busy, update_plan
from rorg.core.inputs import Cache, Inputs
from rorg.core.memory import Memory, ProbeResult, ProbeResults
from rorg.core.peers import stand_ins
from rorg.core.plan import Action, Plan
from rorg.core.requests import Settled
from rorg.core.schedule import Schedule, Target, schedule
from rorg.core.situation import Situation
from rorg.core.withheld import Withheld, emptied, over, withhold
from rorg.model.units import parse_time


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """The result of one pass."""

    planned: Planned
    begin: tuple[Action, ...]
    """Actions to hand to the workers now; `memory` already counts them as under way."""
    memory: Memory
    settled: Settled
    violations: tuple[str, ...] = ()
    deadline: float | None = None
    """When to run the next pass even if nothing wakes the loop; None for never."""
    to_probe: Mapping[tuple[str, str], Target] = field(default_factory=dict)
    """Probes to run, by (service, role)."""
    to_look: Mapping[str, float] = field(default_factory=dict)
    """Container id -> the moment after which a look at it must begin, because a verdict waits for it."""
    holds: Mapping[str, str] = field(default_factory=dict)
    """Services that a person holds now -> the reason."""
    served: Mapping[str, str] = field(default_factory=dict)
    """Requested restarts that are done."""
    retried: Mapping[str, str] = field(default_factory=dict)
    """Retries that were applied."""
    confirmed: tuple[str, ...] = ()
    """Confirmed removals that are done or no longer apply."""
    cache: Cache | None = None
    """For the next pass."""
    _plan: list[Plan] = field(default_factory=list, init=False, compare=False, repr=False)

    @property
    def situation(self) -> Situation:
        return self.planned.situation

    @property
    def plan(self) -> Plan:
        """The whole plan. It is put together when it is first asked for, because most passes over many services end
        without that."""
        if not self._plan:
            self._plan.append(self.planned.plan())
        return self._plan[0]


def decide(inputs: Inputs) -> Decision:
    """Settle requests, plan, check the plan, and pick the actions to begin. A plan that violates an invariant begins
    nothing."""
    inputs = _beside(inputs)
    observed = inputs.observed
    cache = inputs.cache if observed.complete else None
    touched = observed.since(cache.planned.situation.observed) if cache else set[str]()
    inputs, withheld, ended = _withheld(inputs)
    assessed = assess(inputs, cache, touched, withheld)
    situation, tracked = assessed.situation, assessed.tracked
    planned = update_plan(cache.planned if cache else None, situation, touched)
    memory = situation.memory
    if observed.complete:
        memory = forget(memory, planned.replanned, {n for n in planned.replanned if busy(planned, n)})
    violations = tuple(check(planned))
    ready = () if violations or situation.suspended else map(itemgetter(-1), planned.queue)
    chosen = tuple(select(ready, memory.in_flight, inputs.limits, inputs.now))
    memory = begin(memory, chosen, observed, inputs.now)
    due = schedule(cache.schedule if cache else None, planned, inputs.asked)
    return Decision(
        planned=planned,
        begin=chosen,
        memory=memory,
        settled=assessed.settled,
        violations=violations,
        deadline=_deadline(situation, due, inputs),
        to_probe=due.targets,
        to_look=dict(due.looks.values()),
        holds=assessed.holds,
        served=assessed.served,
        retried=inputs.retries,
        confirmed=ended,
        cache=Cache(tracked=tracked, planned=planned, schedule=due) if tracked and not violations else None,
    )


def _beside(inputs: Inputs) -> Inputs:
    """Return the inputs with services of other machines among what is observed."""
    if not inputs.peers.here:
        return inputs
    return replace(inputs, observed=replace(inputs.observed, elsewhere=stand_ins(inputs.peers.remotes)))


def _withheld(inputs: Inputs) -> tuple[Inputs, Withheld, tuple[str, ...]]:
    """Return the inputs with withheld services still desired, the withheld services, and the confirmations that
    ended."""
    memory, catalog, observed = inputs.memory, inputs.desired.catalog, inputs.observed
    if inputs.down:
        return inputs, {}, ()
    requests = (*catalog.requests, *inputs.requests)
    kept, desired, withheld = withhold(memory.kept, inputs.desired, requests, observed, inputs.confirmed)
    ended = over(inputs.confirmed, kept, catalog, observed)
    inputs = replace(
        inputs,
        desired=desired,
        memory=replace(memory, kept=kept),
        removals=inputs.removals and not emptied(catalog),
        confirmed=inputs.confirmed if inputs.removals else (),
    )
    return inputs, withheld, ended


def _deadline(situation: Situation, due: Schedule, inputs: Inputs) -> float | None:
    """Return the earliest future moment at which something is due."""
    now, memory = situation.now, situation.memory
    times = [] if situation.peers.deadline is None else [situation.peers.deadline]
    times += [lease.until for lease in memory.leases.values()]
    holds = (h for h in (*inputs.holds.values(), inputs.suspended) if h is not None)
    times += [now + seconds_left(hold, inputs.moment) for hold in holds]
    times += [now + (parse_time(asked) - inputs.wall) for asked in inputs.restarts.values()]
    times += [at for at in (freed_at(memory.in_flight, now), due.next(now)) if at is not None]
    return min((t for t in times if t > now), default=None)


def unlocked(desired: Desired, now: float) -> ProbeResults:
    """Return an allowing answer for every interlock. Interlocks are asked only before something is done."""
    return {(n, "interlock"): ProbeResult("", True, now) for n, s in desired.catalog.services.items() if s.interlock}


def preview(inputs: Inputs, memory: Memory, desired: Desired) -> Decision:
    """Decide as the last pass did, with other manifests and the present memory. Missing images hold nothing back,
    because they would be obtained first."""
    results = {**inputs.results, **unlocked(desired, inputs.now)}
    return decide(
        replace(
            inputs,
            desired=desired,
            memory=memory,
            results=results,
            removals=True,
            images={},
            load=None,
            asked={},
            cache=None,
        )
    )
