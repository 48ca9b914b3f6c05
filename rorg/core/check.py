"""Invariants of every plan. A violation is a bug in the planner: the pass is aborted before anything happens, because
an action on a robot cannot be undone."""

from __future__ import annotations

from rorg.core.incremental import Planned
from rorg.core.joining import joined_of
from rorg.core.observed import LABEL_JOINED
from rorg.core.operations import Create, CreateObject, ObjectOperation, Remove, RemoveObject, Stop
from rorg.core.plan import Action
from rorg.core.situation import Situation
from rorg.model.objects import is_object, subject


def check(planned: Planned) -> list[str]:
    """Return violations found in the part of the plan that was made in this pass; empty if it may be executed."""
    plans, places, situation = planned.plans, planned.places, planned.situation
    violations: list[str] = []
    for name in planned.replanned:
        actions = plans[name].actions
        if actions and not situation.observed.complete:
            violations.append(f"actions for {name} on an incomplete observation")
        if actions and name in situation.memory.in_flight:
            violations.append(f"a second action for {name} while one is under way")
        if sum(not a.after for a in actions) > 1:
            violations.append(f"two simultaneous actions for {name}")
        for action in actions:
            earlier_services = [earlier for earlier in action.after if earlier != name or not action.index]
            if any(not plans[earlier].actions or places[earlier] >= places[name] for earlier in earlier_services):
                violations.append(f"{action} comes before what it must follow")
            violations += (_on_object if is_object(name) else _on_container)(action, situation)
    return violations


def _on_container(action: Action, situation: Situation) -> list[str]:
    """Check an action on a service."""
    name, containers = action.service, situation.observed.of(action.service)
    known = {c.id: c for c in containers}
    violations = _activation(action, situation) + _joined(action, situation)
    if action.container and action.container not in known:
        owner = next((c.service for c in situation.observed.containers if c.id == action.container), "")
        violations.append(f"{action} touches a container " + (f"of {owner}" if owner else "that is not ours"))
    if not action.after and action.container:
        state = known[action.container].state if action.container in known else ""
        if action.operation.states and state not in action.operation.states:
            violations.append(f"{action} of a container that is {state}")
    if not action.after and action.operation.begins:
        beside = not situation.engine.rolls
        others = [c for c in containers if c.active and c.id != action.container and beside]
        violations += [f"{action} beside another active container of it" for _ in others]
    if situation.interlocks.get(name) and action.operation.felt:
        violations.append(f"{action} against its interlock")
    return violations


def _joined(action: Action, situation: Situation) -> list[str]:
    """Check that a new container is joined only to containers that exist."""
    service = situation.desired.catalog.services.get(action.service)
    if not isinstance(action.operation, Create) or action.after or service is None or not service.joins:
        return []
    ids, containers = joined_of(action.operation.labels.get(LABEL_JOINED, "")), situation.observed.by_service()
    lost = [n for n in service.joins if ids.get(n) not in {c.id for c in containers.get(n, ())}]
    return [f"{action}, joined to no container of {', '.join(lost)}"] if lost else []


def _on_object(action: Action, situation: Situation) -> list[str]:
    """Check an action on a network or volume."""
    objects, declared = situation.observed.objects, situation.desired.objects.get(action.service)
    operation = action.operation
    if objects is None:
        return [f"actions for {action.service} on an incomplete observation"]
    if not isinstance(operation, ObjectOperation):
        return [f"{action} on a container of what has none"]
    existing = objects.found.get(subject(operation.object, operation.name))
    if isinstance(operation, CreateObject) and (
        declared is None or declared.external or (existing is not None and not action.index)
    ):
        return [f"{action}, which is not for rorg to make"]
    if isinstance(operation, RemoveObject):
        if existing is None or existing.owner != situation.owner:
            return [f"{action} touches what is not ours"]
        if existing.kind == "volume" and (declared is not None or not situation.purge):
            return [f"{action} loses data"]
        if declared is None and not situation.removals:
            return [f"{action}, which no manifest declares"]
    return []


def _ready(situation: Situation, name: str) -> bool:
    return situation.memory.of(name).ready or situation.completed(name)


def _activation(action: Action, situation: Situation) -> list[str]:
    """Check that only wanted services begin, with everything they need, and that only unwanted ones end."""
    services, name = situation.desired.catalog.services, action.service
    if name not in services or services[name].meta or services[name].away:
        going = situation.removals or name in situation.confirmed
        ok = going and isinstance(action.operation, (Stop, Remove))
        return [] if ok else [f"{action}, which no manifest declares"]
    if action.operation.begins:
        if name not in situation.wanted:
            return [f"{action}, which nothing wants"]
        unready = [
            n
            for n in services[name].needs
            if not services[n].meta
            and not action.after
            and (situation.peers.unready(services[n]) if services[n].away else not _ready(situation, n))
        ]
        if unready:
            return [f"{action} before {', '.join(unready)} is ready"]
    ends = action.operation.ends
    unplugged = isinstance(action.operation, Stop) and name in situation.unplugged
    if name in situation.wanted and ends and not (action.part_of or action.surplus or unplugged):
        return [f"{action}, which is wanted"]
    return []
