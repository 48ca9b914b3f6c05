"""Plans of networks and volumes: made when a service that is to have a container uses them, made anew or removed once
nothing is connected to them. A volume is never replaced, since it holds data. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

from rorg.core.found_objects import FoundObject
from rorg.core.objects import changed_options, object_digest, object_labels
from rorg.core.operations import CreateObject, RemoveObject
from rorg.core.plan import Action, Part, Waiting
from rorg.core.service_plan import NOTHING, ServicePlan
from rorg.core.situation import Situation
from rorg.core.view import View
from rorg.model.codes import BLOCKED
from rorg.model.objects import EngineObject, keys_of, subject
from rorg.model.units import format_seconds


def declared_objects(situation: Situation) -> list[str]:
    """Subjects of those that manifests declare, and that this engine makes; they come before all services."""
    return list(situation.desired.objects) if situation.observed.objects is not None else []


def former_objects(situation: Situation) -> dict[str, FoundObject]:
    """By subject, networks of ours that no manifest declares and no service that is to have a container names, and
    volumes where these are to go too. They come after all services."""
    objects = situation.observed.objects
    if objects is None:
        return {}
    declared = {one.key for one in situation.desired.objects.values()}
    found = {}
    for key, one in objects.found.items():
        if one.owner == situation.owner and key not in declared and (one.kind == "network" or situation.purge):
            name = subject(one.kind, one.called)
            found[name if name not in situation.desired.objects else f"{name}@{one.id[:12]}"] = one
    if not found:
        return {}
    services = situation.desired.catalog.services.values()
    staying = [s for s in services if s.name in situation.wanted or s.idle.action != "remove"]
    named = {key for s in staying for key in keys_of(s.spec or {})}
    return {name: one for name, one in found.items() if one.key not in named}


def declared_plan(view: View, name: str) -> ServicePlan:
    """Of a network or volume that a manifest declares."""
    one, objects = view.desired.objects[name], view.s.observed.objects
    assert objects is not None
    flight = _under_way(view, name)
    if flight:
        return flight
    found, needed = objects.found.get(one.key), _needed(view, one)
    if found is None and one.key not in objects.asked:
        said = objects.error or "it is being looked for"
        return _waits(Waiting(name, said)) if needed else NOTHING
    if found is not None and (one.external or found.owner == view.s.owner):
        return NOTHING if one.external else _changed(view, one, found)
    if not needed:
        return NOTHING
    if one.external:
        made = f"`docker {one.kind} create {one.called}`, or taking `external` back"
        return _blocked(name, f"no {one.kind} is called '{one.called}', and rorg makes no external one; try {made}")
    if found is not None:
        whose = "belongs to another robot" if found.owner else "was not made by rorg"
        return _blocked(name, f"the {one.kind} '{one.called}' {whose}; try `external: true` to use it as it is")
    return _let_through(view, [_create(view, one, f"{_several(needed)} {_use(needed)} it")])


def former_plan(view: View, name: str, found: FoundObject, moving: Callable[[str], bool]) -> ServicePlan:
    """Of one that is to go. `moving` says of a service whether the plan has actions for it."""
    flight = _under_way(view, name)
    if flight:
        return flight
    if not view.s.removals:
        return _restless(ServicePlan(waitings=(Waiting(name, NOT_NOW),)))
    users = sorted({c.service for c in view.all_containers if _has(c.networks, found)})
    staying = [n for n in users if not moving(n)]
    if staying:
        why = f"no manifest declares it; it goes once nothing is connected to it; connected: {_several(staying)}"
        return _restless(ServicePlan(waitings=(Waiting(name, why, code="deferred"),)))
    why = "it goes with the robot" if view.s.purge and found.kind == "volume" else "no manifest declares it"
    return _restless(_let_through(view, [replace(_remove(name, found, why), after=tuple(users))]))


NOT_NOW = "not declared; its removal is withheld until the manifests load"


def _has(networks: Mapping[str, str], found: FoundObject) -> bool:
    """A container's networks; of volumes it is not known: all containers count."""
    return found.kind == "volume" or found.called in networks


def _under_way(view: View, name: str) -> ServicePlan | None:
    flight = view.s.memory.in_flight.get(name)
    if flight is None:
        return None
    said = f"waits: {flight.action.verb} under way for {format_seconds(view.now - flight.since)}"
    return ServicePlan(unready=said, restless=True)


def _needed(view: View, one: EngineObject) -> tuple[str, ...]:
    """The services that are to have a container and use it."""
    return tuple(n for n in view.desired.users.get(one.subject, ()) if n in view.s.wanted or _keeps(view, n))


def _keeps(view: View, name: str) -> bool:
    """Whether a service has a container while nobody wants it."""
    idle = view.desired.catalog.services[name].idle
    if idle.action == "remove":
        return False
    return bool(view.of(name)) or idle.escalate is None or idle.escalate[1] != "remove"


def _changed(view: View, one: EngineObject, found: FoundObject) -> ServicePlan:
    """One of ours that is there: made anew where it is otherwise than declared and nothing is connected to it."""
    options = changed_options(one, found)
    if not options:
        return NOTHING
    name, told = one.subject, f"changed: {', '.join(options)}"
    if one.kind == "volume":
        remedy = f"`docker volume rm {one.called}`, which loses what is in it"
        return ServicePlan(
            notes=(Waiting(name, f"{told}; it holds data, so it stays as it is; try {remedy}", code=LATER),)
        )
    joined = sorted({c.service for c in view.all_containers if c.alive and found.called in c.networks})
    if joined:
        why = f"{told}; it is made anew once nothing is connected to it; connected: {_several(joined)}"
        return ServicePlan(notes=(Waiting(name, why, code=LATER),), restless=True)
    steps = [_remove(name, found, "changed", options), _create(view, one, "changed", options)]
    return _restless(_let_through(view, [replace(s, part_of=Part.REPLACE) for s in steps]))


LATER = "deferred"


def _create(view: View, one: EngineObject, why: str, options: Sequence[str] = ()) -> Action:
    users = [view.desired.catalog.services[n] for n in view.desired.users.get(one.subject, ())]
    made = CreateObject(
        object=one.kind,
        name=one.called,
        spec=one.spec,
        labels=object_labels(one, view.s.owner),
        digest=object_digest(one),
    )
    return Action(
        index=0,
        operation=made,
        service=one.subject,
        reason=why,
        fields=tuple(options),
        urgent=any(u.name in view.s.urgent for u in users),
        priority=max((u.priority for u in users), default=50),
    )


def _remove(name: str, found: FoundObject, why: str, options: Sequence[str] = ()) -> Action:
    gone = RemoveObject(object=found.kind, name=found.called)
    return Action(index=0, operation=gone, service=name, reason=why, fields=tuple(options))


def _let_through(view: View, actions: Iterable[Action]) -> ServicePlan:
    """A chain of actions, unless one of them has failed and is not to be tried yet."""
    found: list[Action] = []
    for action in actions:
        tried = view.s.memory.of(action.service).attempt(action.operation)
        if tried and tried.at and tried.at > view.now:
            again = format_seconds(tried.at - view.now)
            why = f"{action.verb} failed: {tried.error or 'no effect'}; again in {again}"
            waiting = Waiting(action.service, why, tried.at, "failed")
            return ServicePlan(actions=tuple(found), waitings=(waiting,), unready=f"waits: {why}", restless=True)
        own = (action.service,) if found else ()
        found.append(replace(action, index=len(found), after=(*own, *action.after)))
    return ServicePlan(actions=tuple(found), restless=view.restless)


def _waits(waiting: Waiting) -> ServicePlan:
    return ServicePlan(waitings=(waiting,), unready=f"waits: {waiting.reason}")


def _blocked(name: str, why: str) -> ServicePlan:
    return _waits(Waiting(name, why, code=BLOCKED))


def _restless(plan: ServicePlan) -> ServicePlan:
    """It looks at what other services have."""
    return replace(plan, restless=True)


def _several(names: Sequence[str]) -> str:
    """Some names, and how many more there are."""
    return ", ".join(names[:MOST_NAMED]) + (f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else "")


MOST_NAMED = 3


def _use(names: Sequence[str]) -> str:
    return "use" if len(names) > 1 else "uses"
