"""One pass of the loop as a pure function: everything that was read in, everything to do out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rorg.core.check import check
from rorg.core.desired import Desired, Situation
from rorg.core.lanes import Lanes, relief, select
from rorg.core.memory import Memory, Probe, advance, begin
from rorg.core.observed import Observed
from rorg.core.plan import Action, Plan
from rorg.core.planner import make_plan
from rorg.core.requests import Settled, settle
from rorg.core.wanted import arbitrate, urgent
from rorg.manifest.catalog import Request


@dataclass(frozen=True, slots=True)
class Inputs:
    """What a pass reads. `requests` are those of the requests file; standing ones come with the catalog."""

    desired: Desired
    requests: tuple[Request, ...]
    restarts: Mapping[str, str]
    observed: Observed
    probes: Mapping[str, Probe]
    memory: Memory
    now: float
    owner: str
    removals: bool = True
    booted_at: str = ""
    lanes: Lanes = Lanes()


@dataclass(frozen=True, slots=True)
class Decision:
    situation: Situation
    plan: Plan
    begin: tuple[Action, ...]
    """Actions to hand to workers now; `memory` already counts them as under way."""
    memory: Memory
    settled: Settled
    violations: tuple[str, ...] = ()
    deadline: float | None = None
    """When to look again though nothing wakes the loop; None for never."""
    to_probe: Mapping[str, str] = field(default_factory=dict)
    """Services to probe for readiness, with the incarnation to probe."""


def decide(inputs: Inputs) -> Decision:
    """Resolves requests, plans, checks, and picks what to begin. A plan that violates an invariant begins nothing."""
    desired, now = inputs.desired, inputs.now
    settled = settle(desired.catalog, inputs.requests, inputs.observed)
    found, gave_way = arbitrate(desired.catalog, (*desired.catalog.requests, *settled.requests))
    memory = advance(inputs.memory, desired.catalog, found, inputs.observed, inputs.probes, now, inputs.booted_at)
    situation = Situation(desired, found, urgent(desired.catalog, found), inputs.observed, memory, now, inputs.owner,
                          inputs.restarts, inputs.removals, gave_way)
    plan = make_plan(situation)
    violations = tuple(check(plan, situation))
    chosen = () if violations else tuple(select(plan, memory.in_flight, inputs.lanes, now))
    for action in chosen:
        memory = begin(memory, action, inputs.observed, now)
    return Decision(situation, plan, chosen, memory, settled, violations, _deadline(situation, plan),
                    to_probe(situation))


def _deadline(situation: Situation, plan: Plan) -> float | None:
    times = [w.until for w in plan.waitings if w.until is not None and w.until > situation.now]
    memory = situation.memory
    for name, step in memory.progress.items():
        service = situation.desired.catalog.services.get(name)
        if service and service.ready and step.running_since is not None and not step.ready:
            times.append(step.running_since + (
                float(service.ready.target) if service.ready.probe == "delay" else service.ready.timeout))
    freed = relief(memory.in_flight, situation.now)
    if freed is not None:
        times.append(freed)
    return min((t for t in times if t > situation.now), default=None)


def to_probe(situation: Situation) -> dict[str, str]:
    """Wanted services that run and are not known to be ready; those whose probe is the clock need none."""
    found = {}
    for name in situation.wanted:
        ready, step = situation.desired.catalog.services[name].ready, situation.memory.of(name)
        if ready and ready.probe != "delay" and step.running_since is not None and not step.ready:
            found[name] = step.incarnation
    return found
