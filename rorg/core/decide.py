"""One pass of the loop as a pure function: everything that was read in, everything to do out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from rorg.core.admission import admission_for, admit
from rorg.core.check import check
from rorg.core.content import note_content
from rorg.core.desired import Desired
from rorg.core.digest import rules_of
from rorg.core.dispatch import DispatchLimits, freed_at, select
from rorg.core.eviction import evict
from rorg.core.memory import Memory, ProbeResults, Progress
from rorg.core.observed import Container, Observed
from rorg.core.plan import Action, Plan
from rorg.core.planner import make_plan
from rorg.core.pressure import Load
from rorg.core.requests import Settled, settle
from rorg.core.restarts import note_restarts
from rorg.core.rollout import renew, try_out
from rorg.core.situation import Situation
from rorg.core.transitions import advance, begin, doubt_ends, forget
from rorg.core.wanted import urgent
from rorg.core.withheld import over, withhold
from rorg.model.catalog import Hold, Probe, Request
from rorg.model.units import format_time, parse_time, stamp

FRESH = 1.0
"""Seconds for which the answer of an interlock counts, beyond its interval."""


@dataclass(frozen=True, slots=True)
class Inputs:
    """What a pass reads. `requests`, `restarts`, `holds` and `suspended` are those of the requests file; standing
    requests come with the catalog."""

    desired: Desired
    requests: tuple[Request, ...]
    restarts: Mapping[str, str]
    observed: Observed
    results: ProbeResults
    memory: Memory
    now: float
    owner: str
    removals: bool = True
    booted_at: str = ""
    limits: DispatchLimits = DispatchLimits()
    holds: Mapping[str, Hold] = field(default_factory=dict)
    suspended: Hold | None = None
    wall: float = 0.0
    """Seconds since the epoch, for what people said `until`."""
    load: Load | None = None
    renewals: Mapping[tuple[str, str], int] = field(default_factory=dict)
    """The number of each request's last renewal; another one begins its lease anew."""
    asked: Mapping[str, float] = field(default_factory=dict)
    """Service -> since when somebody waits for it, by the clock of `now`: its readiness must have been told since."""
    confirmed: tuple[str, ...] = ()
    """What a person has confirmed to be removed, though it was named."""


@dataclass(frozen=True, slots=True)
class Target:
    """Something to probe, as long as it is told to. Two equal ones ask the same."""

    probe: Probe
    incarnation: str
    every: float
    container: Container | None = field(default=None, compare=False)
    asked: float | None = field(default=None, compare=False)
    """Somebody waits for an answer that was asked for since then."""


@dataclass(frozen=True, slots=True)
class Decision:
    """What one pass has found, and what is to be begun."""

    situation: Situation
    plan: Plan
    begin: tuple[Action, ...]
    """Actions to hand to workers now; `memory` already counts them as under way."""
    memory: Memory
    settled: Settled
    violations: tuple[str, ...] = ()
    deadline: float | None = None
    """When to look again though nothing wakes the loop; None for never."""
    to_probe: Mapping[tuple[str, str], Target] = field(default_factory=dict)
    """By (service, role)."""
    holds: Mapping[str, str] = field(default_factory=dict)
    """Services that a person holds now, each with the reason."""
    served: Mapping[str, str] = field(default_factory=dict)
    """Restarts that were asked for, and done."""
    confirmed: tuple[str, ...] = ()
    """Confirmed removals that are done, or void."""


def decide(inputs: Inputs) -> Decision:
    """Resolves requests, plans, checks, and picks what to begin. A plan that violates an invariant begins nothing."""
    kept, desired, withheld = withhold(
        inputs.memory.kept,
        inputs.desired,
        (*inputs.desired.catalog.requests, *inputs.requests),
        inputs.observed,
        inputs.confirmed,
    )
    ended = over(inputs.confirmed, kept, inputs.desired.catalog, inputs.observed)
    inputs = replace(inputs, desired=desired, memory=replace(inputs.memory, kept=kept))
    situation, settled, holds, served = _assess(inputs)
    situation = replace(situation, withheld=withheld)
    plan = make_plan(situation)
    memory = situation.memory
    if inputs.observed.complete:
        memory = forget(memory, {a.service for a in plan.actions} | {w.service for w in plan.waitings})
    violations = tuple(check(plan, situation))
    held_back = violations or situation.suspended
    chosen = () if held_back else tuple(select(plan, memory.in_flight, inputs.limits, inputs.now))
    for action in chosen:
        memory = begin(memory, action, inputs.observed, inputs.now)
    return Decision(
        situation,
        plan,
        chosen,
        memory,
        settled,
        violations,
        _deadline(situation, plan, inputs),
        to_probe(situation, plan, inputs.asked),
        holds,
        served,
        ended,
    )


def _assess(inputs: Inputs) -> tuple[Situation, Settled, Mapping[str, str], Mapping[str, str]]:
    """All that the plan depends on; what became of requests; who is held; which restarts are done."""
    desired, now = inputs.desired, inputs.now
    settled = settle(desired.catalog, inputs.requests, inputs.observed, inputs.memory.leases, inputs.renewals, now)
    requests = (*desired.catalog.requests, *settled.requests)
    holds = {n: _until("held", h) for n, h in inputs.holds.items() if h.until > inputs.wall and _can_cease(desired, n)}
    suspension, interlocks = inputs.suspended, _interlocks(inputs)
    suspended = _until("suspended", suspension) if suspension and suspension.until > inputs.wall else ""
    shed = inputs.memory.pressure.shed
    excluded = {**{s.service: s.reason for s in shed}, **holds}
    admitted = admission_for(inputs.memory.admitted, desired.catalog, requests, excluded)
    admission = admitted.admission
    memory = renew(replace(inputs.memory, leases=settled.leases, admitted=admitted), desired.editions)
    memory = advance(memory, desired.catalog, admission.wanted, inputs.observed, inputs.results, now, inputs.booted_at)
    memory = note_content(memory, desired, inputs.observed)
    memory = try_out(memory, desired, admission.wanted, inputs.observed, now)
    memory, eviction = evict(
        memory,
        desired,
        admission,
        admit(desired.catalog, requests, holds) if shed else admission,
        inputs.observed,
        inputs.load,
        excluded,
        [n for n, why in interlocks.items() if why],
        bool(suspended) or not inputs.observed.complete,
    )
    if memory.pressure.shed != shed:
        admission = admit(desired.catalog, requests, {**{s.service: s.reason for s in memory.pressure.shed}, **holds})
    memory, served = note_restarts(memory, inputs.restarts, inputs.observed, stamp(inputs.wall))
    return (
        Situation(
            desired,
            admission.wanted,
            urgent(desired.catalog, admission.wanted),
            inputs.observed,
            memory,
            now,
            inputs.owner,
            {n: due.run for n, due in (memory.restarts or {}).items()},
            inputs.removals,
            admission.preempted,
            frozenset(holds),
            admission.priorities,
            interlocks,
            eviction.lowered,
            eviction.hurry,
            eviction.stop_paused,
            eviction.shed,
            eviction.closed,
            suspended,
        ),
        settled,
        holds,
        served,
    )


def told_since(step: Progress, asked: float | None) -> bool:
    """Whether a readiness probe has said yes since somebody asked."""
    return asked is None or (step.answered is not None and step.answered >= asked)


def _can_cease(desired: Desired, name: str) -> bool:
    service = desired.catalog.services.get(name)
    return service is not None and not service.meta


def _until(word: str, hold: Hold) -> str:
    return f"{word} until {format_time(hold.until)}" + (f": {hold.reason}" if hold.reason else "")


def _interlocks(inputs: Inputs) -> dict[str, str]:
    """What each interlock said just now: empty where it allows."""
    found = {}
    for name, interlock in _all_interlocks(inputs.desired, inputs.observed).items():
        said = inputs.results.get((name, "interlock"))
        if said is None or inputs.now - said.at > interlock.interval + FRESH:
            found[name] = f"{interlock} is being asked"
        else:
            found[name] = "" if said.ok else said.message
    return found


def _all_interlocks(desired: Desired, observed: Observed) -> dict[str, Probe]:
    """Those of the manifests; and of containers that no manifest declares any more, those that they were made with."""
    services = desired.catalog.services
    left = {
        c.service: found
        for c in observed.containers
        if c.rules
        and (c.service not in services or services[c.service].meta)
        and (found := rules_of(c.rules).interlock)
    }
    return {**left, **{name: s.interlock for name, s in services.items() if s.interlock}}


def _deadline(situation: Situation, plan: Plan, inputs: Inputs) -> float | None:
    now, memory = situation.now, situation.memory
    times = [w.until for w in plan.waitings if w.until is not None] + [plan.alarm or 0.0]
    for name, step in memory.progress.items():
        service = situation.desired.catalog.services.get(name)
        if service and service.ready and step.running_since is not None and not step.ready:
            delay = service.ready.delay
            times.append(step.running_since + (service.ready.timeout if delay is None else delay))
        if service and (end := doubt_ends(step, service)) is not None:
            times.append(end)
    times += [lease.until for lease in memory.leases.values()]
    ends = [h.until for h in (*inputs.holds.values(), inputs.suspended) if h is not None]
    ends += [parse_time(asked) for asked in inputs.restarts.values()]
    times += [now + (end - inputs.wall) for end in ends]
    freed = freed_at(memory.in_flight, now)
    if freed is not None:
        times.append(freed)
    return min((t for t in times if t > now), default=None)


def to_probe(situation: Situation, plan: Plan, asked: Mapping[str, float]) -> dict[tuple[str, str], Target]:
    """Readiness of wanted services that run, until they are ready (or always, where it can be lost, and once more for
    whoever begins to wait for them); life of those that are; interlocks of services that the plan wants to touch, or
    that measures against pressure may. A probe that is the clock needs nobody to ask."""
    found: dict[tuple[str, str], Target] = {}
    containers = situation.observed.by_service()
    services = situation.desired.catalog.services
    for name in situation.wanted:
        service, step = services[name], situation.memory.of(name)
        if step.running_since is None:
            continue
        current = next(iter(containers.get(name, [])), None)
        if service.ready and service.ready.kind != "delay":
            since = asked.get(name) if step.answered is not None and not told_since(step, asked.get(name)) else None
            if not step.ready or since is not None or service.ready.failures:
                every = max(service.ready.interval, 1.0) if step.ready and since is None else service.ready.interval
                found[name, "ready"] = Target(service.ready, step.incarnation, every, current, since)
        if service.live and step.was_ready:
            found[name, "live"] = Target(service.live, step.incarnation, service.live.interval, current)
    touched = {a.service for a in plan.actions} | {w.service for w in plan.waitings}
    if situation.memory.pressure.engaged:
        touched |= set(situation.wanted)  # any of them may have to go
    for name, interlock in _all_interlocks(situation.desired, situation.observed).items():
        if name in touched:
            found[name, "interlock"] = Target(interlock, "", interlock.interval)
    return found
