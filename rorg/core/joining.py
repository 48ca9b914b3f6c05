"""Which containers of other services a service's container is joined to, and whether they are still the right ones.

The engine knows them by id (Docker turns a name into the id when the container is made), so another container of the
one means another container of the other. The ids are on a label, and no part of the digest: what is declared is the
service.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import lru_cache

from rorg.core.observed import Container
from rorg.core.plan import Waiting
from rorg.core.rollout import came_up_at, candidate, has_come_up
from rorg.core.view import View
from rorg.model.catalog import Service, Spec
from rorg.model.joining import ends_with, resolved


@lru_cache(maxsize=1024)
def joined_of(label: str) -> Mapping[str, str]:
    """Service -> id of its container, by the label rorg.io/joined; nothing where that cannot be read."""
    try:
        value = json.loads(label) if label else {}
    except (ValueError, RecursionError):
        return {}
    return {str(k): str(v) for k, v in value.items()} if isinstance(value, dict) else {}


def moved(view: View, service: Service, container: Container) -> str:
    """Which service has another container than the one that this container was joined to; empty for none. One that
    nobody wants stays as it is: what it joins may be gone, and come again, many times before it is wanted."""
    if service.name not in view.s.wanted:
        return ""
    for name, there in joined_of(container.joined).items():
        if name in service.joins and there not in (_current(view, name), _coming(view, service, name)):
            return name
    return ""


def can_return(view: View, service: Service, container: Container) -> bool:
    """Whether a container before this one could be gone back to: what it is joined to is still there, and comes back
    with it, since both belong to one set."""
    lost = {n: i for n, i in joined_of(container.joined).items() if n in service.joins and i != _current(view, n)}
    return all(_together(view, service, n) and any(c.id == i for c in view.of(n)) for n, i in lost.items())


def with_ids(view: View, service: Service) -> tuple[Spec, Mapping[str, str]]:
    """The spec as the engine takes it, and what it is joined to (service -> id of its container). As declared, while
    not all that it joins is there: then it is not yet made."""
    spec = service.spec or {}
    ids = {name: _coming(view, service, name) or _current(view, name) for name in service.joins}
    return (resolved(spec, service.joins, ids), ids) if all(ids.values()) else (spec, {})


def missing(view: View, service: Service) -> str:
    """A service that it joins and that has no container; empty for none."""
    return next((name for name in service.joins if not view.of(name)), "")


def is_made_ahead(view: View, name: str) -> bool:
    """Whether a service has a container while nobody wants it, or has ever wanted it."""
    service = view.desired.catalog.services[name]
    idle = service.idle
    ends_removed = idle.escalate is not None and idle.escalate[1] == "remove"
    return idle.action != "remove" and not ends_removed and all(is_made_ahead(view, n) for n in service.joins)


def awaited(view: View, service: Service) -> Waiting | None:
    """Why the running container is not yet replaced by one that is joined to the current containers; None if nothing
    speaks against it. The container that it is joined to may still come back. An unwanted run ends whatever happens to
    that one, so it waits for nothing."""
    for name in service.joins if service.name in view.s.wanted else ():
        if view.active(service.name) and not _together(view, service, name) and tried(view, name):
            up = came_up_at(view.s.memory.of(name), view.desired.catalog.services[name])
            return Waiting(service.name, f"{name} has another container, which is on trial", up)
    return None


def ended(view: View, service: Service, name: str, container: str) -> str:
    """Why a container of the service cannot start now: the container of `name` whose namespace it has does not run.
    Empty if it can. `container` is an id, empty for the one that is to take the place of what runs."""
    mine = next((c for c in view.of(service.name) if c.id == container), None)
    known = joined_of(mine.joined).get(name, "") if mine else _coming(view, service, name)
    there = next((c for c in view.of(name) if c.id == (known or _current(view, name))), None)
    if there is not None and there.alive:
        return ""
    current = view.current(name)
    if there is None or current is None or not current.alive:
        return "has ended, and with it what would be joined"
    return "runs in another container than the one to join"


def is_cut_off(view: View, service: Service, container: Container) -> bool:
    """Whether a container cannot go on as it is: what it is joined to is gone or, if it shares a namespace, has ended
    and made way for another container."""
    for name, there in joined_of(container.joined).items():
        other = next((c for c in view.of(name) if c.id == there), None)
        ended = other is not None and not other.alive and there != _current(view, name)
        if name in service.joins and (other is None or (ended and name in ends_with(service.joins))):
            return True
    return False


def tried(view: View, name: str) -> bool:
    """Whether a new container of it is on trial and has not come up: it may yet be that the one before comes back."""
    step = view.s.memory.of(name)
    pair = candidate(view.of(name), step.update)
    if pair is None:
        return False
    looked = view.s.observed.looked.get(pair[0].id)
    return not has_come_up(step, view.desired.catalog.services[name], looked, view.now)


def _together(view: View, service: Service, other: str) -> bool:
    mine = service.update.atomic
    return mine in view.desired.sets and view.desired.catalog.services[other].update.atomic == mine


def _current(view: View, name: str) -> str:
    found = view.current(name)
    return found.id if found else ""


def _coming(view: View, service: Service, name: str) -> str:
    """The container that a service is about to have: the one before, where it goes back to that; the new one, where it
    changes together with this service: then both are made before any of both is used."""
    update = view.s.memory.of(name).update
    pair = candidate(view.of(name), update)
    if pair is None or not (update.failed or _together(view, service, name)):
        return ""
    return pair[1].id if update.failed else pair[0].id
