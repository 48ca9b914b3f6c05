"""One pass of the loop as a pure function: everything that was read in, everything to do out."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from operator import itemgetter
from typing import Any

from rorg.core.admission import Admission, admission_for, admit
from rorg.core.cache import Cache
from rorg.core.check import check
from rorg.core.desired import Desired
from rorg.core.devices import unplugged
from rorg.core.dispatch import DispatchLimits, freed_at, select
from rorg.core.eviction import Eviction, evict
from rorg.core.follow import Followed, follow, renew_all
from rorg.core.foresight import noted
from rorg.core.memory import Memory, ProbeResults
from rorg.core.missing import Missing
from rorg.core.observed import Observed
from rorg.core.onward import busy, plan_on
from rorg.core.outcomes import begin, forget
from rorg.core.plan import Action, Plan
from rorg.core.pressure import Load
from rorg.core.prewarm import Prewarmed, prewarm
from rorg.core.requests import Settled, settle
from rorg.core.restarts import note_restarts
from rorg.core.rollout import retried
from rorg.core.ros_graph import Graphs
from rorg.core.schedule import Schedule, Target, interlocks, schedule
from rorg.core.situation import Situation
from rorg.core.wanted import Wanted, urgent
from rorg.core.withheld import Withheld, over, withhold
from rorg.model.catalog import Hold, Request
from rorg.model.devices import Device, Plugged
from rorg.model.learned import Learned
from rorg.model.units import format_time, parse_time, stamp

FRESH = 1.0
"""Seconds for which the answer of an interlock counts, beyond its interval."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Inputs:
    """What a pass reads. `requests`, `restarts`, `retries`, `holds` and `suspended` are those of the requests file;
    standing requests come with the catalog."""

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
    retries: Mapping[str, str] = field(default_factory=dict)
    """Service -> when somebody asked that what failed of it be tried again."""
    images: Mapping[str, Missing] = field(default_factory=dict)
    """By reference, those from which no container can be made now."""
    devices: Mapping[Device, Plugged] = field(default_factory=dict)
    """What there is of the devices of drivers; nothing is held back for want of one that is not among them."""
    ros: Graphs = field(default_factory=dict)
    """Graphs of ROS 1, as far as their masters answer."""
    purge: bool = False
    """A person has said that volumes of ours go too."""
    learned: Learned | None = None
    """What was learnt of requests before this loop began, which then goes on learning; None: nothing is prewarmed."""
    cache: Cache | None = None
    """Of the last pass; whatever has changed since is found anew."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Decision:
    """What one pass has found, and what is to be begun."""

    situation: Situation
    plan: Plan
    begin: tuple[Action, ...]
    """Actions to cache to workers now; `memory` already counts them as under way."""
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
    retried: Mapping[str, str] = field(default_factory=dict)
    """The wishes to try again that are heard."""
    confirmed: tuple[str, ...] = ()
    """Confirmed removals that are done, or void."""
    looked_at: tuple[str, ...] = ()
    """Services that were planned in this pass; the others are as at the last one."""
    whole: bool = True
    """All were."""
    cache: Cache | None = None
    """For the next pass."""


def decide(inputs: Inputs) -> Decision:
    """Resolves requests, plans, checks, and picks what to begin. A plan that violates an invariant begins nothing."""
    observed = inputs.observed
    cache = inputs.cache if observed.complete else None
    touched = observed.since(cache.planned.situation.observed) if cache else set[str]()
    inputs, withheld, ended = _withheld(inputs)
    assessed = _assess(inputs, cache, touched, withheld)
    situation, followed = assessed.situation, assessed.followed
    planned = plan_on(cache.planned if cache else None, situation, touched)
    plan, memory = planned.plan(), situation.memory
    if observed.complete:
        memory = forget(memory, planned.looked_at, {n for n in planned.looked_at if busy(planned, n)})
    violations = tuple(check(planned))
    ready = () if violations or situation.suspended else map(itemgetter(-1), planned.turns)
    chosen = tuple(select(ready, memory.in_flight, inputs.limits, inputs.now))
    memory = begin(memory, chosen, observed, inputs.now)
    memory = replace(memory, foresight=noted(memory.foresight, chosen, inputs.now)) if chosen else memory
    due = schedule(cache.schedule if cache else None, planned, inputs.asked)
    return Decision(
        situation=situation,
        plan=plan,
        begin=chosen,
        memory=memory,
        settled=assessed.settled,
        violations=violations,
        deadline=_deadline(situation, due, inputs, assessed.warm.look),
        to_probe=due.targets,
        holds=assessed.holds,
        served=assessed.served,
        retried=inputs.retries,
        confirmed=ended,
        looked_at=planned.looked_at,
        whole=planned.whole,
        cache=Cache(followed=followed, planned=planned, schedule=due) if followed and not violations else None,
    )


def _withheld(inputs: Inputs) -> tuple[Inputs, Withheld, tuple[str, ...]]:
    """The inputs with what is withheld still desired; what that is; confirmations that are done, or void."""
    memory, catalog, observed = inputs.memory, inputs.desired.catalog, inputs.observed
    requests = (*catalog.requests, *inputs.requests)
    kept, desired, withheld = withhold(memory.kept, inputs.desired, requests, observed, inputs.confirmed)
    ended = over(inputs.confirmed, kept, catalog, observed)
    return replace(inputs, desired=desired, memory=replace(memory, kept=kept)), withheld, ended


@dataclass(frozen=True, slots=True, kw_only=True)
class _Assessed:
    situation: Situation
    followed: Followed | None
    settled: Settled
    holds: Mapping[str, str]
    served: Mapping[str, str]
    warm: Prewarmed


def _assess(inputs: Inputs, cache: Cache | None, touched: Collection[str], withheld: Withheld) -> _Assessed:
    """All that the plan depends on; what became of requests; who is held; which restarts are done."""
    desired, now = inputs.desired, inputs.now
    settled = settle(desired.catalog, inputs.requests, inputs.observed, inputs.memory.leases, inputs.renewals, now)
    requests = (*desired.catalog.requests, *settled.requests)
    (holds, suspended), locks = _held(inputs), _interlocks(inputs)
    out = _excluded(inputs.memory, holds)
    admitted = admission_for(inputs.memory.admitted, desired.catalog, requests, out)
    admission = admitted.admission
    memory = retried(replace(inputs.memory, leases=settled.leases, admitted=admitted), inputs.retries)
    memory, followed = _followed(memory, admission.wanted, inputs, cache, touched)
    blocked = [n for n, why in locks.items() if why]
    memory, eviction, admission = _evicted(memory, inputs, admission, requests, holds, blocked, bool(suspended))
    memory, warm = _prewarmed(memory, inputs, admission, requests, _excluded(memory, holds), bool(suspended))
    memory, served = note_restarts(memory, inputs.restarts, inputs.observed, stamp(inputs.wall))
    situation = Situation(
        desired=desired,
        wanted=warm.wanted,
        urgent=_urgent(desired, admission.wanted, cache),
        observed=inputs.observed,
        memory=memory,
        now=now,
        owner=inputs.owner,
        restarts={n: due.run for n, due in (memory.restarts or {}).items()},
        removals=inputs.removals,
        preempted=admission.preempted,
        prewarmed=warm.names,
        excluded=frozenset(holds),
        priorities=admission.priorities,
        interlocks=locks,
        lowered=eviction.lowered,
        hurry=eviction.hurry,
        stop_paused=eviction.stop_paused,
        shed=eviction.shed,
        closed=eviction.closed,
        suspended=suspended,
        purge=inputs.purge,
        withheld=withheld,
        **_found(inputs),
    )
    return _Assessed(situation=situation, followed=followed, settled=settled, holds=holds, served=served, warm=warm)


def _held(inputs: Inputs) -> tuple[dict[str, str], str]:
    """Services that a person holds now, and why nothing is done at all; each with the reason."""
    held = {n: h for n, h in inputs.holds.items() if h.until > inputs.wall and _can_cease(inputs.desired, n)}
    holds, suspension = {n: _until("held", h) for n, h in held.items()}, inputs.suspended
    return holds, _until("suspended", suspension) if suspension and suspension.until > inputs.wall else ""


def _excluded(memory: Memory, holds: Mapping[str, str]) -> dict[str, str]:
    return {**{s.service: s.reason for s in memory.pressure.shed}, **holds}


def _evicted(
    memory: Memory,
    inputs: Inputs,
    admission: Admission,
    requests: tuple[Request, ...],
    holds: Mapping[str, str],
    locked: Collection[str],
    suspended: bool,
) -> tuple[Memory, Eviction, Admission]:
    """What pressure changes: who is shed has to be admitted anew."""
    catalog, shed = inputs.desired.catalog, memory.pressure.shed
    memory, eviction = evict(
        memory,
        inputs.desired,
        admission,
        admit(catalog, requests, holds) if shed else admission,
        inputs.observed,
        inputs.load,
        _excluded(memory, holds),
        locked,
        suspended or not inputs.observed.complete,
    )
    if memory.pressure.shed != shed:
        admission = admit(catalog, requests, _excluded(memory, holds))
    return memory, eviction, admission


def _prewarmed(
    memory: Memory,
    inputs: Inputs,
    admission: Admission,
    requests: tuple[Request, ...],
    excluded: Collection[str],
    suspended: bool,
) -> tuple[Memory, Prewarmed]:
    """Comes after all that is asked for and all that pressure changes, and changes nothing of that."""
    desired, observed = inputs.desired, inputs.observed
    barred = {*excluded, *unplugged(desired, inputs.devices)}
    off = suspended or memory.pressure.engaged or not observed.complete
    return prewarm(memory, inputs.learned, desired, admission, requests, observed, barred, inputs.now, off)


def _found(inputs: Inputs) -> dict[str, Any]:
    """What there is beside containers, for a Situation."""
    missing = unplugged(inputs.desired, inputs.devices)
    return {"images": inputs.images, "devices": inputs.devices, "unplugged": missing, "ros": inputs.ros}


def _followed(
    memory: Memory, wanted: Wanted, inputs: Inputs, cache: Cache | None, touched: Collection[str]
) -> tuple[Memory, Followed | None]:
    if not inputs.observed.complete:
        return renew_all(memory, inputs.desired), None
    return follow(
        cache.followed if cache else None,
        memory,
        inputs.desired,
        wanted,
        inputs.observed,
        inputs.results,
        inputs.now,
        inputs.booted_at,
        touched,
        unplugged(inputs.desired, inputs.devices),
    )


def _urgent(desired: Desired, found: Wanted, cache: Cache | None) -> frozenset[str]:
    before = cache.planned.situation if cache else None
    return before.urgent if before and before.wanted is found else urgent(desired.catalog, found)


def _can_cease(desired: Desired, name: str) -> bool:
    service = desired.catalog.services.get(name)
    return service is not None and not service.meta


def _until(word: str, hold: Hold) -> str:
    return f"{word} until {format_time(hold.until)}" + (f": {hold.reason}" if hold.reason else "")


def _interlocks(inputs: Inputs) -> dict[str, str]:
    """What each interlock said just now: empty where it allows."""
    found = {}
    for name, interlock in interlocks(inputs.desired, inputs.observed).items():
        said = inputs.results.get((name, "interlock"))
        fresh = said is not None and inputs.now - said.at <= interlock.interval + FRESH
        answer = said.message if said and fresh else f"{interlock} is being asked"
        found[name] = "" if said and fresh and said.ok else answer
    return found


def _deadline(situation: Situation, due: Schedule, inputs: Inputs, look: float | None) -> float | None:
    now, memory = situation.now, situation.memory
    times = [] if look is None else [look]
    times += [lease.until for lease in memory.leases.values()]
    ends = [h.until for h in (*inputs.holds.values(), inputs.suspended) if h is not None]
    ends += [parse_time(asked) for asked in inputs.restarts.values()]
    times += [now + (end - inputs.wall) for end in ends]
    times += [at for at in (freed_at(memory.in_flight, now), due.next(now)) if at is not None]
    return min((t for t in times if t > now), default=None)
