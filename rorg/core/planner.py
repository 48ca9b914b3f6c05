"""The one planner. For each service: the whole chain of engine calls that leads from what is observed to what is
desired, as far as it may happen now; what must wait for other actions of the plan is linked to them, and the rest is a
waiting with a reason. Pure.

A service's plan depends on the situation, and on the plans of services that come before it. So a plan can be made anew
for some services only (see onward.py), by the same code as for all.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

from rorg.core.exclusive import Exclusive
from rorg.core.gates import gate, unready
from rorg.core.object_plans import declared_objects, declared_plan, former_objects, former_plan
from rorg.core.plan import Action, Waiting
from rorg.core.reconcile import chain
from rorg.core.service_plan import NOTHING, ServicePlan
from rorg.core.situation import Situation
from rorg.core.steps import Step, away
from rorg.core.view import View
from rorg.model.catalog import Service
from rorg.model.objects import is_object
from rorg.model.units import format_seconds

LAST = -1
"""Priority of what nobody has requested yet: below every priority."""


def in_order(situation: Situation) -> list[str]:
    """Subjects in the order in which they are planned: networks and volumes that are declared; what must be ceased,
    dependants first; what must run, needs first; networks and volumes that go. Meta-services have nothing to plan."""
    services, wanted = situation.desired.catalog.services, situation.wanted
    own = [n for n in situation.desired.order if not services[n].meta]
    ceasing = [n for n in reversed(own) if n not in wanted]
    of_services = [*sorted(undeclared(situation)), *ceasing, *(n for n in own if n in wanted)]
    return [*declared_objects(situation), *of_services, *sorted(former_objects(situation))]


def undeclared(situation: Situation) -> set[str]:
    """Services with a container that no manifest declares, or not as having one."""
    return situation.observed.by_service().keys() - situation.desired.digests.keys()


def leave_at_once(situation: Situation, exclusive: Exclusive) -> frozenset[str]:
    """What is in somebody's way, or must not be active; and what needs that."""
    found: set[str] = set()
    wanted, desired = situation.wanted, situation.desired
    for name in desired.order:
        if name in wanted:
            continue
        service = desired.catalog.services[name]
        if (
            name in situation.preempted
            or name in situation.excluded
            or any(o in wanted for o in desired.conflicts.get(name, ()))
            or any(n in found for n in service.needs)
            or exclusive.contested(service)
        ):
            found.add(name)
    return frozenset(found)


class Planner:
    """Of one situation. `places` is the order of the services; `plans` are filled in by plan()."""

    def __init__(self, situation: Situation, places: Mapping[str, int], leaving: Collection[str] | None) -> None:
        self.s, self.places = situation, places
        self.services = situation.desired.catalog.services
        self.containers = situation.observed.by_service()
        self.undeclared = {n: self.containers[n] for n in undeclared(situation)}
        self.former = former_objects(situation)
        self.exclusive = Exclusive(situation, self.containers, self.undeclared)
        self.leaving = leave_at_once(situation, self.exclusive) if leaving is None else leaving
        self.plans: dict[str, ServicePlan] = {}

    def plan(self, name: str) -> ServicePlan:
        """The plan of one service, once those of all before it that it looks at are there."""
        view = View(self.s, self.containers, self.exclusive)
        self.plans[name] = found = self._plan(name, view)
        return found

    def _plan(self, name: str, view: View) -> ServicePlan:
        if name in self.former:
            return former_plan(view, name, self.former[name], Before(self, name).moving)
        if name in self.s.desired.objects:
            return declared_plan(view, name)
        return self._undeclared(name, view) if name in self.undeclared else self._declared(self.services[name], view)

    def _undeclared(self, name: str, view: View) -> ServicePlan:
        """A service of ours that no manifest declares any more."""
        if name in self.s.memory.in_flight or name in self.s.withheld:
            return NOTHING
        if not (self.s.removals or name in self.s.confirmed):
            why = "not declared; its removal is withheld until the manifests load"
            return ServicePlan(waitings=(Waiting(name, why),))
        steps = [s for c in self.containers[name] for s in away(c, "no manifest declares it", volumes=True)]
        actions, waitings, _ = self._let_through(Service(name), steps, view)
        return ServicePlan(actions=actions, waitings=waitings, restless=view.restless)

    def _declared(self, service: Service, view: View) -> ServicePlan:
        name, flight = service.name, self.s.memory.in_flight.get(service.name)
        if flight:
            blocked = f"{flight.action.verb} under way for {format_seconds(view.now - flight.since)}"
            return ServicePlan(unready=f"waits: {blocked}", restless=True)
        if any(c.state == "removing" for c in view.of(name)):
            blocked = "the engine is removing its container"
            return ServicePlan(waitings=(Waiting(name, blocked),), unready=f"waits: {blocked}")
        found = chain(view, service, Before(self, name).moving)
        actions, waitings, blocked = self._let_through(service, found.steps, view)
        needed = self.s.desired.dependants[name]
        return ServicePlan(
            actions=actions,
            waitings=waitings,
            notes=found.notes,
            alarm=found.alarm,
            unready=unready(view, service, blocked, [a.operation for a in actions]) if needed else "",
            restless=view.restless,
        )

    def _let_through(
        self, service: Service, steps: Iterable[Step], view: View
    ) -> tuple[tuple[Action, ...], tuple[Waiting, ...], str]:
        """A chain's steps up to the first one that must wait; what is waited for; and why it stops short, for those who
        wait for it. A name or an option that the engine refuses holds nothing back."""
        actions: list[Action] = []
        waitings: dict[Waiting, None] = {}
        before = Before(self, service.name)
        for step in steps:
            linked, waiting = gate(view, service, step, before, self.leaving)
            if waiting:
                waitings[waiting] = None
                if step.operation.optional:
                    continue
                return tuple(actions), tuple(waitings), waiting.reason
            own = (service.name,) if actions else ()
            actions.append(self._action(service, step, len(actions), tuple(dict.fromkeys(own + linked)), view))
        return tuple(actions), tuple(waitings), ""

    def _action(self, service: Service, step: Step, index: int, after: tuple[str, ...], view: View) -> Action:
        return Action(
            index=index,
            operation=step.operation,
            service=service.name,
            reason=step.reason,
            fields=step.fields,
            after=after,
            urgent=self._is_urgent(service.name, step, view),
            priority=LAST if service.name in self.s.prewarmed else service.priority,
            driver=service.driver,
            part_of=step.part_of,
            surplus=step.surplus,
        )

    def _is_urgent(self, name: str, step: Step, view: View) -> bool:
        """What brings up a service that a live request waits for; not what replaces one that runs."""
        if name not in self.s.urgent:
            return False
        return step.operation.brings_up and not view.active(name)


class Before:
    """What a service may know of the plans of others: those that come before it."""

    def __init__(self, planner: Planner, service: str) -> None:
        self.planner, self.place = planner, planner.places[service]

    def _plan(self, name: str) -> ServicePlan:
        places = self.planner.places
        return self.planner.plans[name] if name in places and places[name] < self.place else NOTHING

    def moving(self, name: str) -> bool:
        return bool(self._plan(name).actions)

    def code(self, name: str) -> str:
        return next((w.code for w in self._plan(name).waitings), "")

    def unready(self, name: str) -> str:
        if is_object(name):
            return self._plan(name).unready
        service = self.planner.services.get(name)
        return "is not declared" if service is None else "" if service.meta else self._plan(name).unready
