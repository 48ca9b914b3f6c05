"""Plans of networks and volumes. They are created when a service that uses them gets a container, and replaced or
removed once nothing is connected to them. A volume is never replaced, because it holds data."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

from rorg.core.objects import changed_options, object_digest, object_labels
from rorg.core.observed import FoundObject
from rorg.core.operations import CreateObject, RemoveObject
from rorg.core.plan import NOTHING, Action, Part, ServicePlan, Waiting
from rorg.core.situation import Situation, View
from rorg.model.codes import BLOCKED
from rorg.model.objects import EngineObject, keys_of, subject
from rorg.model.units import format_seconds


def declared_objects(situation: Situation) -> list[str]:
    """Return the subjects of declared networks and volumes, if this engine creates such objects. They are planned
    before all services."""
    return list(situation.desired.objects) if situation.observed.objects is not None else []


def former_objects(situation: Situation) -> dict[str, FoundObject]:
    """Return, by subject, rorg's networks that are no longer declared nor named by a service that keeps a container,
    and volumes if those are purged. They are planned after all services."""
    objects = situation.observed.objects
    if objects is None:
        return {}
    declared = {existing.key for existing in situation.desired.objects.values()}
    former = {}
    for key, existing in objects.found.items():
        if (
            existing.owner == situation.owner
            and key not in declared
            and (existing.kind == "network" or situation.purge)
        ):
            name = subject(existing.kind, existing.called)
            former[name if name not in situation.desired.objects else f"{name}@{existing.id[:12]}"] = existing
    if not former:
        return {}
    services = situation.desired.catalog.services.values()
    staying = [s for s in services if s.name in situation.wanted or s.idle.action != "remove"]
    named = {key for s in staying for key in keys_of(s.spec or {})}
    return {name: existing for name, existing in former.items() if existing.key not in named}


def declared_plan(view: View, name: str) -> ServicePlan:
    """Plan a declared network or volume."""
    declared, objects = view.desired.objects[name], view.s.observed.objects
    assert objects is not None
    under_way = _under_way(view, name)
    if under_way:
        return under_way
    existing, needed = objects.found.get(declared.key), _needed(view, declared)
    if existing is None and declared.key not in objects.asked:
        why = objects.error or "it is being looked for"
        return _waits(Waiting(name, why)) if needed else NOTHING
    if existing is not None and (declared.external or existing.owner == view.s.owner):
        return NOTHING if declared.external else _changed(view, declared, existing)
    if not needed:
        return NOTHING
    if declared.external:
        remedy = f"`docker {declared.kind} create {declared.called}`, or remove `external`"
        return _blocked(
            name, f"no {declared.kind} is called '{declared.called}', and rorg creates no external ones; try {remedy}"
        )
    if existing is not None:
        whose = "belongs to another robot" if existing.owner else "was not made by rorg"
        return _blocked(
            name, f"the {declared.kind} '{declared.called}' {whose}; try `external: true` to use it as it is"
        )
    return _let_through(view, [_create(view, declared, f"{_listed(needed)} {_use(needed)} it")])


def former_plan(view: View, name: str, former: FoundObject, has_actions: Callable[[str], bool]) -> ServicePlan:
    """Plan the removal of one that is no longer declared. `has_actions` returns whether the plan has actions for a
    service."""
    under_way = _under_way(view, name)
    if under_way:
        return under_way
    if not view.s.removals:
        return _volatile(ServicePlan(waitings=(Waiting(name, NOT_NOW),)))
    users = sorted({c.service for c in view.all_containers if _has(c.networks, former)})
    staying = [n for n in users if not has_actions(n)]
    if staying:
        why = f"no manifest declares it; it goes once nothing is connected to it; connected: {_listed(staying)}"
        return _volatile(ServicePlan(waitings=(Waiting(name, why, code="deferred"),)))
    why = "the robot is taken down" if view.s.purge and former.kind == "volume" else "no manifest declares it"
    return _volatile(_let_through(view, [replace(_remove(name, former, why), after=tuple(users))]))


NOT_NOW = "not declared; its removal is withheld until the manifests load"


def _has(networks: Mapping[str, str], existing: FoundObject) -> bool:
    """Return whether a container uses the network. Which containers use a volume is not known, so all of them count."""
    return existing.kind == "volume" or existing.called in networks


def _under_way(view: View, name: str) -> ServicePlan | None:
    flight = view.s.memory.in_flight.get(name)
    if flight is None:
        return None
    said = f"waits: {flight.action.verb} under way for {format_seconds(view.now - flight.since)}"
    return ServicePlan(unready=said, volatile=True)


def _needed(view: View, declared: EngineObject) -> tuple[str, ...]:
    """Return the services that use it and have or will get a container."""
    return tuple(n for n in view.desired.users.get(declared.subject, ()) if n in view.s.wanted or _keeps(view, n))


def _keeps(view: View, name: str) -> bool:
    """Return whether a service keeps its container while unwanted."""
    idle = view.desired.catalog.services[name].idle
    if idle.action == "remove":
        return False
    return bool(view.of(name)) or idle.escalate is None or idle.escalate[1] != "remove"


def _changed(view: View, declared: EngineObject, existing: FoundObject) -> ServicePlan:
    """Plan an existing object: recreate it if its options changed and nothing is connected to it. Docker cannot change
    a network in place, nor remove one that is in use."""
    options = changed_options(declared, existing)
    if not options:
        return NOTHING
    name, changed_text = declared.subject, f"changed: {', '.join(options)}"
    if declared.kind == "volume":
        remedy = f"`docker volume rm {declared.called}`, which deletes its data"
        return ServicePlan(
            notes=(Waiting(name, f"{changed_text}; it holds data, so it stays as it is; try {remedy}", code=LATER),)
        )
    joined = sorted({c.service for c in view.all_containers if c.alive and existing.called in c.networks})
    if joined:
        why = f"{changed_text}; it is recreated once nothing is connected to it; connected: {_listed(joined)}"
        return ServicePlan(notes=(Waiting(name, why, code=LATER),), volatile=True)
    steps = [_remove(name, existing, "changed", options), _create(view, declared, "changed", options)]
    return _volatile(_let_through(view, [replace(s, part_of=Part.REPLACE) for s in steps]))


LATER = "deferred"


def _create(view: View, declared: EngineObject, why: str, options: Sequence[str] = ()) -> Action:
    users = [view.desired.catalog.services[n] for n in view.desired.users.get(declared.subject, ())]
    creation = CreateObject(
        object=declared.kind,
        name=declared.called,
        spec=declared.spec,
        labels=object_labels(declared, view.s.owner),
        digest=object_digest(declared),
    )
    return Action(
        index=0,
        operation=creation,
        service=declared.subject,
        reason=why,
        fields=tuple(options),
        urgent=any(u.name in view.s.urgent for u in users),
        priority=max((u.priority for u in users), default=50),
    )


def _remove(name: str, existing: FoundObject, why: str, options: Sequence[str] = ()) -> Action:
    removal = RemoveObject(object=existing.kind, name=existing.called)
    return Action(index=0, operation=removal, service=name, reason=why, fields=tuple(options))


def _let_through(view: View, actions: Iterable[Action]) -> ServicePlan:
    """Return a chain of actions up to one whose last attempt failed and which is still in back-off."""
    allowed: list[Action] = []
    for action in actions:
        tried = view.s.memory.of(action.service).attempt(action.operation)
        if tried and tried.at and tried.at > view.now:
            again = format_seconds(tried.at - view.now)
            why = f"{action.verb} failed: {tried.error or 'no effect'}; again in {again}"
            waiting = Waiting(action.service, why, tried.at, "failed")
            return ServicePlan(actions=tuple(allowed), waitings=(waiting,), unready=f"waits: {why}", volatile=True)
        own = (action.service,) if allowed else ()
        allowed.append(replace(action, index=len(allowed), after=(*own, *action.after)))
    return ServicePlan(actions=tuple(allowed), volatile=view.volatile)


def _waits(waiting: Waiting) -> ServicePlan:
    return ServicePlan(waitings=(waiting,), unready=f"waits: {waiting.reason}")


def _blocked(name: str, why: str) -> ServicePlan:
    return _waits(Waiting(name, why, code=BLOCKED))


def _volatile(plan: ServicePlan) -> ServicePlan:
    """Mark a plan that depends on the containers of other services."""
    return replace(plan, volatile=True)


def _listed(names: Sequence[str]) -> str:
    """Return some names, and how many more there are."""
    return ", ".join(names[:MOST_NAMED]) + (f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else "")


MOST_NAMED = 3


def _use(names: Sequence[str]) -> str:
    return "use" if len(names) > 1 else "uses"
