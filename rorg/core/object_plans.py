"""Plans of networks and volumes. They are created when a service that uses them gets a container, and replaced or
removed once nothing is connected to them. A volume is never replaced, because it holds data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from rorg.core.objects import changed_options, object_digest, object_labels
from rorg.core.observed import FoundObject
from rorg.core.operations import CreateObject, RemoveObject
from rorg.core.plan import Part, Waiting
from rorg.core.situation import Situation, View
from rorg.core.steps import Chain, Step
from rorg.model.codes import BLOCKED
from rorg.model.objects import EngineObject, keys_of, subject


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
    named = {key for s in staying for key in keys_of(s.options)}
    return {name: existing for name, existing in former.items() if existing.key not in named}


def declared_chain(view: View, name: str) -> Chain:
    """Return the chain of a declared network or volume."""
    declared, objects = view.desired.objects[name], view.s.observed.objects
    assert objects is not None
    existing, needed = objects.found.get(declared.key), _needed(view, declared)
    if existing is None and declared.key not in objects.asked:
        return Chain(waiting=Waiting(name, objects.error or "checking whether it exists")) if needed else Chain()
    if existing is not None and (declared.external or existing.owner == view.s.owner):
        return Chain() if declared.external else _changed(view, declared, existing)
    if not needed:
        return Chain()
    if declared.external:
        why = f"no {declared.kind} is called '{declared.called}', and rorg creates no external ones"
        remedy = f"`docker {declared.kind} create {declared.called}`, or remove `external`"
    elif existing is not None:
        whose = "belongs to another robot" if existing.owner else "was not made by rorg"
        why = f"the {declared.kind} '{declared.called}' {whose}"
        remedy = "`external: true` to use it as it is"
    else:
        return Chain([_create(view, declared, f"{_listed(needed)} {_use(needed)} it")])
    return Chain(waiting=Waiting(name, f"{why}; try {remedy}", code=BLOCKED))


def former_chain(view: View, name: str, former: FoundObject) -> Chain:
    """Return the chain that removes one that is no longer declared."""
    users = sorted({c.service for c in view.all_containers if _has(c.networks, former)})
    staying = [n for n in users if not view.has_actions(n)]
    if staying:
        why = f"no manifest declares it; it goes once nothing is connected to it; connected: {_listed(staying)}"
        return Chain(waiting=Waiting(name, why, code=LATER))
    why = "the robot is taken down" if view.s.purge and former.kind == "volume" else "no manifest declares it"
    return Chain([replace(_remove(former, why), after=tuple(users))])


def _has(networks: Mapping[str, str], existing: FoundObject) -> bool:
    """Return whether a container uses the network. Which containers use a volume is not known, so all of them count."""
    return existing.kind == "volume" or existing.called in networks


def _needed(view: View, declared: EngineObject) -> tuple[str, ...]:
    """Return the services that use it and have or will get a container."""
    return tuple(n for n in view.desired.users.get(declared.subject, ()) if n in view.s.wanted or _keeps(view, n))


def _keeps(view: View, name: str) -> bool:
    """Return whether a service keeps its container while unwanted."""
    idle = view.desired.catalog.services[name].idle
    if idle.action == "remove":
        return False
    return bool(view.of(name)) or idle.escalate is None or idle.escalate[1] != "remove"


def _changed(view: View, declared: EngineObject, existing: FoundObject) -> Chain:
    """Return the chain of an existing object: recreate it if its options changed and nothing is connected to it. Docker
    cannot change a network in place, nor remove one that is in use."""
    options = changed_options(declared, existing)
    if not options:
        return Chain()
    name, changed_text = declared.subject, f"changed: {', '.join(options)}"
    if declared.kind == "volume":
        remedy = f"`docker volume rm {declared.called}`, which deletes its data"
        why = f"{changed_text}; it holds data, so it stays as it is; try {remedy}"
        return Chain(notes=[Waiting(name, why, code=LATER)])
    joined = sorted({c.service for c in view.all_containers if c.alive and existing.called in c.networks})
    if joined:
        why = f"{changed_text}; it is recreated once nothing is connected to it; connected: {_listed(joined)}"
        return Chain(notes=[Waiting(name, why, code=LATER)])
    steps = [_remove(existing, "changed"), _create(view, declared, "changed")]
    return Chain([replace(s, fields=options, part_of=Part.REPLACE) for s in steps])


LATER = "deferred"


def _create(view: View, declared: EngineObject, why: str) -> Step:
    creation = CreateObject(
        object=declared.kind,
        name=declared.called,
        spec=declared.spec,
        labels=object_labels(declared, view.s.owner),
        digest=object_digest(declared),
    )
    return Step(creation, why)


def _remove(existing: FoundObject, why: str) -> Step:
    return Step(RemoveObject(object=existing.kind, name=existing.called), why)


def _listed(names: Sequence[str]) -> str:
    """Return some names, and how many more there are."""
    return ", ".join(names[:MOST_NAMED]) + (f" and {len(names) - MOST_NAMED} more" if len(names) > MOST_NAMED else "")


MOST_NAMED = 3


def _use(names: Sequence[str]) -> str:
    return "use" if len(names) > 1 else "uses"
