"""The planner: for each service, the chain of engine calls from what is observed to what is desired, as far as it may
happen now. A step that must follow other services' actions is linked to them; a step that must wait becomes a waiting
with a reason.

The plan of a service depends on the situation and on the plans of services before it. So incremental.py can plan some
services again with the same code that plans all.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

from rorg.core.gates import gate, unready
from rorg.core.object_plans import declared_objects, declared_plan, former_objects, former_plan
from rorg.core.plan import NOTHING, Action, ServicePlan, Waiting
from rorg.core.reconcile import chain
from rorg.core.situation import Exclusive, Situation, View
from rorg.core.steps import Step, away
from rorg.model.catalog import Service
from rorg.model.objects import is_object
from rorg.model.units import format_seconds

LAST = -1
"""Priority of services that are not requested yet: below every other."""


def in_order(situation: Situation) -> list[str]:
    """Return all subjects in planning order: declared networks and volumes; services to cease, dependants first;
    services to run, needs first; networks and volumes to remove. Meta-services have nothing to plan."""
    services, wanted = situation.desired.catalog.services, situation.wanted
    own = [n for n in situation.desired.order if not services[n].meta]
    ceasing = [n for n in reversed(own) if n not in wanted]
    of_services = [*sorted(undeclared(situation)), *ceasing, *(n for n in own if n in wanted)]
    return [*declared_objects(situation), *of_services, *sorted(former_objects(situation))]


def undeclared(situation: Situation) -> set[str]:
    """Return services with a container that are not declared, or are declared without a container."""
    return situation.observed.by_service().keys() - situation.desired.digests.keys()


def without_linger(situation: Situation, exclusive: Exclusive) -> frozenset[str]:
    """Return unwanted services that must cease immediately, because they must not be active or hold back a wanted
    service, and those that need them."""
    names: set[str] = set()
    wanted, desired = situation.wanted, situation.desired
    for name in desired.order:
        if name in wanted:
            continue
        service = desired.catalog.services[name]
        if (
            name in situation.preempted
            or name in situation.excluded
            or any(o in wanted for o in desired.conflicts.get(name, ()))
            or any(n in names for n in service.needs)
            or exclusive.contested(service)
        ):
            names.add(name)
    return frozenset(names)


class Planner:
    """Plans one situation. `places` is the order of services; plan() fills `plans`."""

    def __init__(self, situation: Situation, places: Mapping[str, int], no_linger: Collection[str] | None) -> None:
        self.s, self.places = situation, places
        self.services = situation.desired.catalog.services
        self.containers = situation.observed.by_service()
        self.undeclared = {n: self.containers[n] for n in undeclared(situation)}
        self.former = former_objects(situation)
        self.exclusive = Exclusive(situation, self.containers, self.undeclared)
        self.no_linger = without_linger(situation, self.exclusive) if no_linger is None else no_linger
        self.plans: dict[str, ServicePlan] = {}

    def plan(self, name: str) -> ServicePlan:
        """Plan one service. The plans before it in order must exist."""
        view = View(self.s, self.containers, self.exclusive)
        self.plans[name] = made = self._plan(name, view)
        return made

    def _plan(self, name: str, view: View) -> ServicePlan:
        if name in self.former:
            return former_plan(view, name, self.former[name], EarlierPlans(self, name).has_actions)
        if name in self.s.desired.objects:
            return declared_plan(view, name)
        return self._undeclared(name, view) if name in self.undeclared else self._declared(self.services[name], view)

    def _undeclared(self, name: str, view: View) -> ServicePlan:
        """Plan the removal of a service that is no longer declared."""
        if name in self.s.memory.in_flight or name in self.s.withheld:
            return NOTHING
        if not (self.s.removals or name in self.s.confirmed):
            why = "not declared; its removal is withheld until the manifests load"
            return ServicePlan(waitings=(Waiting(name, why),))
        steps = [s for c in self.containers[name] for s in away(c, "no manifest declares it", volumes=True)]
        actions, waitings, _ = self._let_through(Service(name), steps, view)
        return ServicePlan(actions=actions, waitings=waitings, volatile=view.volatile)

    def _declared(self, service: Service, view: View) -> ServicePlan:
        name, flight = service.name, self.s.memory.in_flight.get(service.name)
        if flight:
            blocked = f"{flight.action.verb} under way for {format_seconds(view.now - flight.since)}"
            return ServicePlan(unready=f"waits: {blocked}", volatile=True)
        if any(c.state == "removing" for c in view.of(name)):
            blocked = "the engine is removing its container"
            return ServicePlan(waitings=(Waiting(name, blocked),), unready=f"waits: {blocked}")
        desired_chain = chain(view, service, EarlierPlans(self, name).has_actions)
        actions, waitings, blocked = self._let_through(service, desired_chain.steps, view)
        needed = self.s.desired.dependants[name]
        return ServicePlan(
            actions=actions,
            waitings=waitings,
            notes=desired_chain.notes,
            alarm=desired_chain.alarm,
            unready=unready(view, service, blocked, [a.operation for a in actions]) if needed else "",
            volatile=view.volatile,
        )

    def _let_through(
        self, service: Service, steps: Iterable[Step], view: View
    ) -> tuple[tuple[Action, ...], tuple[Waiting, ...], str]:
        """Return a chain's steps up to the first that must wait, what is waited for, and why the chain stops there. An
        optional step that must wait does not stop the chain."""
        actions: list[Action] = []
        waitings: dict[Waiting, None] = {}
        earlier = EarlierPlans(self, service.name)
        for step in steps:
            linked, waiting = gate(view, service, step, earlier, self.no_linger)
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
        """Return whether a step brings up a service that a live request waits for. Replacing one that runs is not
        urgent."""
        if name not in self.s.urgent:
            return False
        return step.operation.brings_up and not view.active(name)


class EarlierPlans:
    """What a service may know about other plans: only those before it in order, so that the result does not depend on
    the order of planning within a pass."""

    def __init__(self, planner: Planner, service: str) -> None:
        self.planner, self.place = planner, planner.places[service]

    def _plan(self, name: str) -> ServicePlan:
        places = self.planner.places
        return self.planner.plans[name] if name in places and places[name] < self.place else NOTHING

    def has_actions(self, name: str) -> bool:
        return bool(self._plan(name).actions)

    def code(self, name: str) -> str:
        return next((w.code for w in self._plan(name).waitings), "")

    def unready(self, name: str) -> str:
        if is_object(name):
            return self._plan(name).unready
        service = self.planner.services.get(name)
        return "is not declared" if service is None else "" if service.meta else self._plan(name).unready
