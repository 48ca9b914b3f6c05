"""The planner: for each service, the chain of engine calls from what is observed to what is desired, as far as it may
happen now. A step that must follow other services' actions is linked to them; a step that must wait becomes a waiting
with a reason.

The plan of a service depends on the situation and on the plans of services before it. So incremental.py can plan some
services again with the same code that plans all.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Set
from graphlib import CycleError, TopologicalSorter

from rorg.core.gates import gate, not_removed, unready, waits
from rorg.core.joining import joined_of
from rorg.core.object_plans import declared_chain, declared_objects, former_chain, former_objects
from rorg.core.observed import Container
from rorg.core.operations import CreateObject, Remove, Rename
from rorg.core.plan import NOTHING, Action, Reason, ServicePlan, Timed, Waiting
from rorg.core.reconcile import chain
from rorg.core.situation import Exclusive, Situation, View
from rorg.core.steps import Chain, Step, away
from rorg.model.catalog import Service
from rorg.model.codes import OWNER


def in_order(situation: Situation) -> list[str]:
    """Return all subjects in planning order: declared networks and volumes; services to cease, dependants first;
    services to run, needs first; networks and volumes to remove. Meta-services, and services of other machines, have
    nothing to plan."""
    wanted = situation.wanted
    own = [n for n in situation.desired.order if n in situation.desired.digests]
    ceasing = [n for n in reversed(own) if n not in wanted]
    of_services = [*_joiners_first(situation, undeclared(situation)), *ceasing, *(n for n in own if n in wanted)]
    return [*declared_objects(situation), *of_services, *sorted(former_objects(situation))]


def _joiners_first(situation: Situation, names: Collection[str]) -> list[str]:
    """Return services without a manifest, each after those that are joined to its containers."""
    joiners = {n: [o for o in names if any(n in joined_of(c.joined) for c in situation.observed.of(o))] for n in names}
    try:
        return [*TopologicalSorter({n: sorted(joiners[n]) for n in sorted(names)}).static_order()]
    except CycleError:  # labels may say anything
        return sorted(names)


def undeclared(situation: Situation) -> Set[str]:
    """Return services with a container that are not declared, or are declared without a container."""
    return situation.observed.undeclared(situation.desired.digests)


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
            or not wanted.keys().isdisjoint(desired.conflicts.get(name, ()))
            or not names.isdisjoint(service.needs)
            or (service.exclusive and exclusive.contested(service))
        ):
            names.add(name)
    return frozenset(names)


def _removing(view: View, name: str) -> list[Container]:
    """Return the containers that the engine is removing."""
    return [c for c in view.of(name) if c.state == "removing"]


class Planner:
    """Plans one situation. `places` is the order of services; plan() fills `plans`."""

    def __init__(self, situation: Situation, places: Mapping[str, int], no_linger: Collection[str] | None) -> None:
        self.s, self.places = situation, places
        self.services = situation.desired.catalog.services
        self.undeclared = {n: situation.observed.of(n) for n in undeclared(situation)}
        self.former = former_objects(situation)
        self.exclusive = Exclusive(situation, self.undeclared)
        self.no_linger = without_linger(situation, self.exclusive) if no_linger is None else no_linger
        self.plans: dict[str, ServicePlan] = {}

    def plan(self, name: str) -> ServicePlan:
        """Plan one service. The plans before it in order must exist."""
        place = self.places[name]

        def earlier(other: str) -> ServicePlan:
            return self.plans[other] if self.places.get(other, place) < place else NOTHING

        view = View(self.s, self.exclusive, earlier, self.s.measures.hurry or name in self.no_linger)
        self.plans[name] = made = self._plan(name, view)
        return made

    def _plan(self, name: str, view: View) -> ServicePlan:
        flight = self.s.memory.in_flight.get(name)
        service = self.services[name] if name in self.s.desired.digests else Service(name)
        if flight:
            return ServicePlan(unready=Timed(f"waits: {flight.action.verb} under way for ", flight.since))
        led = self._chain(name, service, view)
        actions, waitings, blocked = self._let_through(service, led.steps, view)
        if led.waiting:
            waitings, blocked = (led.waiting,), led.waiting.reason
        missing = waits(blocked) if blocked else ""
        if not led.waiting and self.s.desired.dependants.get(name):
            missing = unready(view, service, blocked, [a.operation for a in actions])
        return ServicePlan(
            actions=actions,
            waitings=waitings,
            notes=(*led.notes, *(not_removed(name, c.id, "it has begun to") for c in _removing(view, name))),
            alarm=led.alarm,
            unready=missing,
            volatile=view.volatile,
            until=view.until,
        )

    def _chain(self, name: str, service: Service, view: View) -> Chain:
        """Return what leads to the desired state if nothing is in the way."""
        gone = name in self.former or name in self.undeclared
        if gone and name in self.s.withheld:
            return Chain()
        if gone and not (self.s.removals or name in self.s.confirmed):
            return Chain(waiting=Waiting(name, "not declared; its removal is withheld until the manifests load"))
        if name in self.former:
            return former_chain(view, name, self.former[name])
        if name in self.undeclared:
            moved = self.services[name].away if name in self.services else ""
            why = f"it belongs to {moved} now" if moved else "no manifest declares it"
            return Chain([s for c in view.of(name) for s in away(c, why, volumes=True)])
        if name in self.s.desired.objects:
            return declared_chain(view, name)
        if name in self.s.peers.unowned:
            return Chain(waiting=Waiting(name, self.s.peers.unowned[name], code=OWNER))
        return chain(view, service)

    def _let_through(
        self, service: Service, steps: Iterable[Step], view: View
    ) -> tuple[tuple[Action, ...], tuple[Waiting, ...], Reason]:
        """Return a chain's steps up to the first that must wait, what is waited for, and why the chain stops there. An
        optional step that must wait does not stop the chain."""
        actions: list[Action] = []
        waitings: dict[Waiting, None] = {}
        kept = {c.name for c in _removing(view, service.name)}
        """Names of containers whose removal has to wait."""
        for step in steps:
            if isinstance(step.operation, Rename) and step.operation.name in kept:
                continue  # the name is not free yet
            linked, waiting = gate(view, service, step)
            if waiting:
                waitings[waiting] = None
                if isinstance(step.operation, Remove):
                    kept |= {c.name for c in view.of(service.name) if c.id == step.operation.container}
                if step.operation.optional:
                    continue
                return tuple(actions), tuple(waitings), waiting.reason
            own = (service.name,) if actions else ()
            after = tuple(dict.fromkeys((*own, *step.after, *linked)))
            actions.append(self._action(service, step, len(actions), after, view))
        return tuple(actions), tuple(waitings), ""

    def _action(self, service: Service, step: Step, index: int, after: tuple[str, ...], view: View) -> Action:
        name = service.name
        users = self.s.desired.users.get(name, ()) if isinstance(step.operation, CreateObject) else ()
        # Replacing a service that runs is not urgent.
        urgent = step.operation.brings_up and not view.active(name)
        priority = max((self.services[n].priority for n in users), default=service.priority)
        return Action(
            index=index,
            operation=step.operation,
            service=name,
            reason=step.reason,
            fields=step.fields,
            after=after,
            urgent=urgent and any(n in self.s.urgent for n in users or (name,)),
            priority=priority,
            driver=service.driver,
            part_of=step.part_of,
            surplus=step.surplus,
        )
