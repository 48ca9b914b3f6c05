"""Incremental planning: plan only the services that changed since the last pass, and those whose plans depend on them.
So the cost of a pass grows with the changes, and bringing up N services costs about N.

The result is the same as a whole plan. The plan of a service depends on:

- its own containers, progress, interlock and call under way, and why it is wanted;
- containers and progress of services related to it (depending_plans);
- the plans of services before it in order;
- everything in a Situation that concerns all services: if that changes, all are planned again.
"""

from __future__ import annotations

import heapq
from bisect import bisect_left, insort
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import chain
from math import inf
from operator import attrgetter

from rorg.core.changes import changed_keys, differing
from rorg.core.joining import joined_of
from rorg.core.plan import NOTHING, Action, Plan, Reason, ServicePlan, Waiting
from rorg.core.planner import Planner, in_order, undeclared, without_linger
from rorg.core.ros_graph import graph_of
from rorg.core.situation import Situation
from rorg.core.wanted import wanted_by
from rorg.model.objects import is_object

QueueEntry = tuple[bool, bool, int, int, Action]
"""(not urgent, no driver, -priority, place, action that can begin now). Sorted, the first entry is the most
important."""
OWN = ("observed", "memory", "now", "interlocks", "peers", "wanted", "urgent", "priorities")
"""Fields of a Situation that are compared per service."""
SHOWN = ("rivals", "asked")
"""Fields that no plan depends on. Every other field concerns all services."""
COMMON = tuple(f.name for f in fields(Situation) if f.name not in (*OWN, *SHOWN))


@dataclass(frozen=True, slots=True, kw_only=True)
class Planned:
    """The plan of one situation, by service."""

    situation: Situation
    places: Mapping[str, int]
    names: Sequence[str]
    """By place."""
    plans: Mapping[str, ServicePlan]
    no_linger: frozenset[str]
    volatile: frozenset[str]
    counting: frozenset[str]
    """Services whose plan changes at a known time; see ServicePlan.until."""
    queue: Sequence[QueueEntry]
    replanned: tuple[str, ...]
    """Services planned in this pass."""

    @property
    def whole(self) -> bool:
        """Whether all services were planned in this pass."""
        return self.replanned is self.names

    def plan(self) -> Plan:
        """Return the whole plan. It is empty while the engine does not report what exists."""
        s, plans = self.situation, self.plans.values()
        if not s.observed.complete:
            return Plan(waitings=(Waiting("engine", s.observed.error or "the engine has not answered yet"),))
        waitings: list[Waiting] = [*chain.from_iterable(map(attrgetter("waitings"), plans))]
        waitings += [Waiting(name, reason, code="preempted") for name, reason in s.preempted.items()]
        waitings += [
            Waiting(name, f"its removal is withheld because {why}; confirm it with `rorg apply`", code="withheld")
            for name, why in s.withheld.items()
        ]
        waitings += chain.from_iterable(map(attrgetter("notes"), plans))
        if s.suspended:
            waitings.append(Waiting("rorg", s.suspended, code="suspended"))
        actions = tuple(chain.from_iterable(map(attrgetter("actions"), plans)))
        return Plan(actions, tuple(waitings), s.now)


def plan_all(situation: Situation) -> Planned:
    """Plan all services, using nothing from an earlier plan."""
    names = tuple(in_order(situation))
    planner = Planner(situation, {name: place for place, name in enumerate(names)}, None)
    nothing = Planned(
        situation=situation,
        places=planner.places,
        names=names,
        plans=dict.fromkeys(names, NOTHING),
        no_linger=frozenset(planner.no_linger),
        volatile=frozenset(),
        counting=frozenset(),
        queue=(),
        replanned=names,
    )
    if not situation.observed.complete:
        return nothing
    for name in names:
        planner.plan(name)
    queue = sorted(entry for name in names if (entry := _queue_entry(planner.plans[name], planner.places[name])))
    volatile = frozenset(n for n, p in planner.plans.items() if p.volatile)
    counting = frozenset(n for n, p in planner.plans.items() if p.until < inf)
    return replace(nothing, plans=planner.plans, volatile=volatile, counting=counting, queue=queue)


def update_plan(kept: Planned | None, situation: Situation, touched: Collection[str]) -> Planned:
    """Return the plan of a situation, reusing what still holds. `touched` are services whose containers changed since
    the `kept` plan was made."""
    # Undeclared containers are rare and may be in the way of any service: plan everything.
    if (
        kept is None
        or _any_undeclared(kept, situation, touched)
        or not situation.observed.complete
        or _common_changed(kept.situation, situation)
    ):
        return plan_all(situation)
    before = kept.situation
    changed = _changed_progress(before, situation) | set(touched) | _changed_wants(before, situation)
    changed |= situation.peers.changed(before.peers)
    kept = _moved(kept, situation)
    no_linger = kept.no_linger
    planner = Planner(situation, kept.places, no_linger)
    if before.wanted is not situation.wanted or any(n in situation.desired.rivals for n in changed):
        planner.no_linger = no_linger = without_linger(situation, planner.exclusive)
    planner.plans = {**kept.plans}
    was, now = before.interlocks, situation.interlocks
    locks = {n for n in situation.desired.interlocks if was.get(n) != now.get(n)}
    calls = before.memory.in_flight.keys() ^ situation.memory.in_flight.keys()
    depending = {n for name in changed | calls for n in depending_plans(situation, name)}
    depending |= {n for name in changed for n in situation.desired.uses.get(name, ())}
    seen = (c for name in touched for s in (before, situation) for c in s.observed.of(name) if c.joined)
    depending |= {n for c in seen for n in joined_of(c.joined)}
    over = {n for n in kept.counting if kept.plans[n].until <= situation.now} | kept.volatile
    replanned = _replan(planner, kept, changed | depending | locks | calls | (no_linger ^ kept.no_linger) | over)
    return _with_replanned(kept, planner, replanned, no_linger)


def _any_undeclared(kept: Planned, situation: Situation, touched: Collection[str]) -> bool:
    """Return whether something without a digest has, or had, a container here. Services of other machines have none."""
    desired = situation.desired
    others = [n for n in touched if n not in desired.digests]
    return bool(undeclared(situation)) or any(n in kept.places or n not in desired.dependants for n in others)


def busy(planned: Planned, name: str) -> bool:
    """Return whether the plan has actions or waitings for a service."""
    s = planned.situation
    return planned.plans[name].busy or (s.observed.complete and (name in s.preempted or name in s.withheld))


def depending_plans(situation: Situation, name: str) -> Iterable[str]:
    """Return the subjects whose plans depend on the state of this service, network or volume."""
    desired, wanted = situation.desired, situation.wanted
    if name not in desired.dependants:
        yield from desired.users.get(name, ())
        return
    service = desired.catalog.services[name]
    yield from desired.dependants[name]
    yield from desired.rivals.get(name, ())
    yield from (n for n in service.needs if n not in wanted)  # needs cease after what needs them
    yield from service.joins  # former containers go after those that are joined to them


def _common_changed(before: Situation, now: Situation) -> bool:
    """Return whether something changed that concerns all services."""
    objects = before.observed.objects, now.observed.objects
    pairs = (objects, *((getattr(before, name), getattr(now, name)) for name in COMMON))
    return any(old is not new and old != new for old, new in pairs) or before.desired is not now.desired


def _changed_progress(before: Situation, now: Situation) -> set[str]:
    """Return the subjects whose progress changed."""
    names = changed_keys(before.memory.progress, now.memory.progress)
    return {name for name in names if name in now.desired.digests or is_object(name)}


def _changed_wants(before: Situation, now: Situation) -> set[str]:
    """Return the services for which it has changed whether, why, how urgently or with what priority they are wanted.
    The chain of reasons leads through a service to those that are wanted because of it, so they are included. So are
    the unwanted ones of a ROS graph: a service is not paused while it is connected to a wanted one."""
    if before.wanted is now.wanted:
        return set()
    names = differing(before.wanted, now.wanted) | differing(before.priorities, now.priorities)
    names |= before.urgent ^ now.urgent
    names |= wanted_by(now.wanted, names)
    if now.ros:
        services, unwanted = now.desired.catalog.services, now.desired.digests.keys() - now.wanted.keys()
        names |= {name for name in unwanted if graph_of(services[name]) in now.ros}
    return names


def _moved(kept: Planned, situation: Situation) -> Planned:
    """Return the kept plans in the order of this situation: services that cease come before those that run."""
    if kept.situation.wanted is situation.wanted or kept.situation.wanted.keys() == situation.wanted.keys():
        return kept
    names = tuple(in_order(situation))
    places = {name: place for place, name in enumerate(names)}
    plans = {name: kept.plans[name] for name in names}
    queue = sorted(entry for name in names if (entry := _queue_entry(plans[name], places[name])))
    return replace(kept, names=names, places=places, plans=plans, queue=queue)


def _replan(planner: Planner, kept: Planned, names: Collection[str]) -> tuple[str, ...]:
    """Plan these again, in order, and then those that depend on a plan whose outcome changed."""
    places, replanned = kept.places, []
    pending = [places[n] for n in names if n in places]
    heapq.heapify(pending)
    last = -1
    while pending:
        place = heapq.heappop(pending)
        if place == last:
            continue
        last, name = place, kept.names[place]
        old_plan, new_plan = kept.plans[name], planner.plan(name)
        replanned.append(name)
        if _seen_by_others(old_plan) != _seen_by_others(new_plan):
            for depending in depending_plans(planner.s, name):
                if places.get(depending, -1) > place:
                    heapq.heappush(pending, places[depending])
    return tuple(replanned)


def _seen_by_others(plan: ServicePlan) -> tuple[bool, bool, Reason]:
    """Return what the plans of other services depend on."""
    return bool(plan.actions), plan.runs, plan.unready


def _with_replanned(kept: Planned, planner: Planner, replanned: tuple[str, ...], no_linger: frozenset[str]) -> Planned:
    queue, volatile, counting = [*kept.queue], set(kept.volatile), set(kept.counting)
    for name in replanned:
        old_plan, new_plan, place = kept.plans[name], planner.plans[name], kept.places[name]
        (volatile.add if new_plan.volatile else volatile.discard)(name)
        (counting.add if new_plan.until < inf else counting.discard)(name)
        old_entry, new_entry = _queue_entry(old_plan, place), _queue_entry(new_plan, place)
        if old_entry:
            del queue[bisect_left(queue, old_entry[:4])]
        if new_entry:
            insort(queue, new_entry)
    return replace(
        kept,
        situation=planner.s,
        plans=planner.plans,
        no_linger=no_linger,
        volatile=frozenset(volatile),
        counting=frozenset(counting),
        queue=queue,
        replanned=replanned,
    )


def _queue_entry(plan: ServicePlan, place: int) -> QueueEntry | None:
    """Return the entry of a plan's first action, if it can begin now. Later actions always follow the first."""
    first = plan.actions[0] if plan.actions else None
    if first is None or first.after:
        return None
    return not first.urgent, not first.driver, -first.priority, place, first
