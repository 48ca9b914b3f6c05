"""The plan in hand: where only some services are otherwise than at the last pass, only these are planned again, with
those whose plans depend on them. So the cost of a pass grows with what has changed, and bringing up N services costs N.

The plan is the same as one that is made with nothing kept: what a service's plan depends on is its own containers,
progress, call under way and interlock; the containers and progress of its neighbours; what those before it have in the
plan; and what concerns everybody, which makes all be planned again.
"""

from __future__ import annotations

import heapq
from bisect import bisect_left, insort
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import chain
from operator import attrgetter

from rorg.core.changes import changed_keys
from rorg.core.plan import Action, Plan, Waiting
from rorg.core.planner import Planner, in_order, leave_at_once, undeclared
from rorg.core.service_plan import NOTHING, ServicePlan
from rorg.core.situation import Situation
from rorg.model.objects import is_object

Turn = tuple[bool, bool, int, int, Action]
"""(not urgent, no driver, -priority, place, what may be begun now): sorted, who comes first."""
OWN = ("observed", "memory", "now", "interlocks")
"""What of a situation is looked at for each service by itself; all else concerns everybody."""
COMMON = tuple(f.name for f in fields(Situation) if f.name not in OWN)


@dataclass(frozen=True, slots=True, kw_only=True)
class Planned:
    """The plan of one situation, service by service in their order."""

    situation: Situation
    places: Mapping[str, int]
    names: Sequence[str]
    """By place."""
    plans: Mapping[str, ServicePlan]
    leaving: frozenset[str]
    restless: frozenset[str]
    turns: Sequence[Turn]
    looked_at: tuple[str, ...]
    """Services that were planned in this pass."""

    @property
    def whole(self) -> bool:
        """All services were planned in this pass."""
        return self.looked_at is self.names

    def plan(self) -> Plan:
        """The whole of it. While the engine does not tell what is there, nothing is done."""
        s, plans = self.situation, self.plans.values()
        if not s.observed.complete:
            return Plan(waitings=(Waiting("engine", s.observed.error or "the engine has not answered yet"),))
        waitings: list[Waiting] = [*chain.from_iterable(map(attrgetter("waitings"), plans))]
        waitings += [Waiting(name, reason, code="preempted") for name, reason in s.preempted.items()]
        waitings += [
            Waiting(name, f"its removal is withheld, since {why}; confirm it with `rorg apply`", code="withheld")
            for name, why in s.withheld.items()
        ]
        waitings += chain.from_iterable(map(attrgetter("notes"), plans))
        if s.suspended:
            waitings.append(Waiting("rorg", s.suspended, code="suspended"))
        # An alarm depends on the time, or it would be none: so whoever has one is restless.
        alarms = [alarm for name in self.restless if (alarm := self.plans[name].alarm) is not None]
        actions = tuple(chain.from_iterable(map(attrgetter("actions"), plans)))
        return Plan(actions, tuple(waitings), min(alarms, default=None))


def plan_all(situation: Situation) -> Planned:
    """A whole plan, with nothing kept from an earlier one."""
    names = tuple(in_order(situation))
    places = {name: place for place, name in enumerate(names)}
    planner = Planner(situation, places, None)
    for name in names:
        if situation.observed.complete:
            planner.plan(name)
        else:
            planner.plans[name] = NOTHING
    turns = sorted(turn for name in names if (turn := _turn(planner.plans[name], places[name])))
    return Planned(
        situation=situation,
        places=places,
        names=names,
        plans=planner.plans,
        leaving=frozenset(planner.leaving),
        restless=frozenset(n for n, p in planner.plans.items() if p.restless),
        turns=turns,
        looked_at=names,
    )


def plan_on(kept: Planned | None, situation: Situation, touched: Collection[str]) -> Planned:
    """`touched` are services whose containers are others, or otherwise, than when the plan in hand was made."""
    # What no manifest declares is rare, and may be in anybody's way.
    strange = bool(undeclared(situation)) or any(n not in situation.desired.digests for n in touched)
    if kept is None or strange or not situation.observed.complete or _differs(kept.situation, situation):
        return plan_all(situation)
    changed = _changed(kept.situation, situation) | set(touched)
    leaving = kept.leaving
    planner = Planner(situation, kept.places, leaving)
    if any(n in situation.desired.rivals for n in changed):
        planner.leaving = leaving = leave_at_once(situation, planner.exclusive)
    planner.plans = {**kept.plans}
    locks = {n for n in situation.desired.interlocks if _lock(kept.situation, n) != _lock(situation, n)}
    calls = kept.situation.memory.in_flight.keys() ^ situation.memory.in_flight.keys()
    near = {n for name in changed | calls for n in neighbours(situation, name)}
    near |= {n for name in changed for n in situation.desired.uses.get(name, ())}
    looked_at = _again(planner, kept, changed | near | locks | calls | (leaving ^ kept.leaving) | kept.restless)
    return _renewed(kept, planner, looked_at, leaving)


def busy(planned: Planned, name: str) -> bool:
    """Whether the plan has anything to say of a service."""
    s = planned.situation
    return planned.plans[name].busy or (s.observed.complete and (name in s.preempted or name in s.withheld))


def neighbours(situation: Situation, name: str) -> Iterable[str]:
    """Whose plan depends on how this service, network or volume is."""
    desired, wanted = situation.desired, situation.wanted
    if name not in desired.dependants:
        yield from desired.users.get(name, ())
        return
    service = desired.catalog.services[name]
    yield from desired.dependants[name]
    yield from desired.rivals.get(name, ())
    yield from (n for n in service.needs if n not in wanted)  # what ceases does so after what needs it


def _differs(before: Situation, now: Situation) -> bool:
    """Whether anything is otherwise that concerns everybody."""
    objects = before.observed.objects, now.observed.objects
    pairs = (objects, *((getattr(before, name), getattr(now, name)) for name in COMMON))
    return any(a is not b and a != b for a, b in pairs) or before.desired is not now.desired


def _changed(before: Situation, now: Situation) -> set[str]:
    """Of whom something else is remembered."""
    found = changed_keys(before.memory.progress, now.memory.progress)
    return {name for name in found if name in now.desired.digests or is_object(name)}


def _lock(situation: Situation, name: str) -> str | None:
    return situation.interlocks.get(name)


def _again(planner: Planner, kept: Planned, names: Collection[str]) -> tuple[str, ...]:
    """Plans these again, in order; and whoever comes after one that shows itself otherwise than before."""
    places, found = kept.places, []
    pending = [places[n] for n in names if n in places]
    heapq.heapify(pending)
    last = -1
    while pending:
        place = heapq.heappop(pending)
        if place == last:
            continue
        last, name = place, kept.names[place]
        before, now = kept.plans[name], planner.plan(name)
        found.append(name)
        if (bool(before.actions), before.unready) != (bool(now.actions), now.unready):
            for other in neighbours(planner.s, name):
                if places.get(other, -1) > place:
                    heapq.heappush(pending, places[other])
    return tuple(found)


def _renewed(kept: Planned, planner: Planner, looked_at: tuple[str, ...], leaving: frozenset[str]) -> Planned:
    turns, restless = [*kept.turns], set(kept.restless)
    for name in looked_at:
        before, now, place = kept.plans[name], planner.plans[name], kept.places[name]
        (restless.add if now.restless else restless.discard)(name)
        old, new = _turn(before, place), _turn(now, place)
        if old:
            del turns[bisect_left(turns, old[:4])]
        if new:
            insort(turns, new)
    return Planned(
        situation=planner.s,
        places=kept.places,
        names=kept.names,
        plans=planner.plans,
        leaving=leaving,
        restless=frozenset(restless),
        turns=turns,
        looked_at=looked_at,
    )


def _turn(plan: ServicePlan, place: int) -> Turn | None:
    """Only the first action of a chain can follow nothing."""
    first = plan.actions[0] if plan.actions else None
    if first is None or first.after:
        return None
    return not first.urgent, not first.driver, -first.priority, place, first
