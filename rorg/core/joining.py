"""Joined containers (`network_mode: service:NAME`, `volumes_from`): which containers a service is joined to, and
whether these are still the current ones.

Docker resolves a name to a container id when the container is created. So a new container of one service requires a new
container of the other. The ids are in a label and not in the digest, because the manifest only declares the service.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from functools import lru_cache

from rorg.core.observed import Container
from rorg.core.plan import Waiting
from rorg.core.probes_in_force import fits
from rorg.core.rollout import came_up_at, has_come_up
from rorg.core.situation import View
from rorg.core.trial import candidate, went_back
from rorg.model.catalog import Service, Spec
from rorg.model.joining import ends_with, resolved


@lru_cache(maxsize=1024)
def joined_of(label: str) -> Mapping[str, str]:
    """Return service -> id of its container, from the label rorg.io/joined; empty if it is unreadable."""
    try:
        value = json.loads(label) if label else {}
    except (ValueError, RecursionError):
        return {}
    return {str(k): str(v) for k, v in value.items()} if isinstance(value, dict) else {}


def joined_to(containers: Iterable[Container], container: str) -> list[Container]:
    """Return the containers that are joined to this one, by its id."""
    return [c for c in containers if c.joined and container in joined_of(c.joined).values()]


def moved(view: View, service: Service, container: Container) -> str:
    """Return a service that has another container than the one this container was joined to; "" for none. While the
    service is unwanted, a container that is gone does not count: it may go and come many times before it matters. But
    one that is to be removed counts: it may have to wait for this one."""
    for name, joined_id in joined_of(container.joined).items():
        if name in service.joins and joined_id not in (_current(view, name), _coming(view, service, name)):
            left = any(c.id == joined_id for c in view.of(name)) and not tried(view, name)
            if left or service.name in view.s.wanted:
                return name
    return ""


def can_return(view: View, service: Service, container: Container) -> bool:
    """Return whether it is possible to go back to this container: the containers it is joined to are in use, or come
    back with it, because both belong to one set."""
    lost = {n: i for n, i in joined_of(container.joined).items() if n in service.joins and i != _current(view, n)}
    failed = bool(view.s.memory.of(service.name).update.failed)
    return all(
        _together(view, service, n)
        and any(c.id == i for c in view.of(n))
        and not (failed and i != _coming(view, service, n))
        for n, i in lost.items()
    )


def with_ids(view: View, service: Service) -> tuple[Spec, Mapping[str, str]]:
    """Return the spec with ids for the engine, and what it is joined to (service -> container id). If a joined
    container is missing, return the spec as declared; it cannot be created yet."""
    spec = service.options
    ids = {name: _coming(view, service, name) or _current(view, name) for name in service.joins}
    return (resolved(spec, service.joins, ids), ids) if all(ids.values()) else (spec, {})


def missing(view: View, service: Service) -> str:
    """Return a joined service without a container; "" if there is none."""
    return next((name for name in service.joins if not view.of(name)), "")


def is_made_ahead(view: View, name: str) -> bool:
    """Return whether a service gets a container before it is wanted."""
    service = view.desired.catalog.services[name]
    idle = service.idle
    ends_removed = idle.escalate is not None and idle.escalate[1] == "remove"
    return idle.action != "remove" and not ends_removed and all(is_made_ahead(view, n) for n in service.joins)


def awaited(view: View, service: Service) -> Waiting | None:
    """Return why a running container is not replaced although a joined service has a new container; None if nothing
    prevents it. While that one is on trial, the previous one may come back. An unwanted run ends either way, so it does
    not wait."""
    for name in service.joins if service.name in view.s.wanted else ():
        if view.active(service.name) and not _together(view, service, name) and tried(view, name):
            up = came_up_at(view.s.memory.of(name), view.desired.catalog.services[name])
            return Waiting(service.name, f"{name} has another container, which is on trial", up)
    return None


def ended(view: View, service: Service, name: str, container: str) -> str:
    """Return why a container of the service cannot start: the container of `name` whose namespace it uses does not run.
    "" if it can. `container` is an id, "" for a container still to be created."""
    container_of_service = next((c for c in view.of(service.name) if c.id == container), None)
    joined_id = (
        joined_of(container_of_service.joined).get(name, "") if container_of_service else _coming(view, service, name)
    )
    joined = next((c for c in view.of(name) if c.id == (joined_id or _current(view, name))), None)
    if joined is not None and joined.alive:
        return ""
    current = view.current(name)
    if joined is None or current is None or not current.alive:
        return "has ended, so there is nothing to join"
    return "runs in another container than the one to join"


def is_cut_off(view: View, service: Service, container: Container) -> bool:
    """Return whether a container cannot go on as it is: a container it is joined to is gone, or it shares the namespace
    of one that has ended and been replaced."""
    for name, joined_id in joined_of(container.joined).items():
        other = next((c for c in view.of(name) if c.id == joined_id), None)
        has_ended = other is not None and not other.alive and joined_id != _current(view, name)
        if name in service.joins and (other is None or (has_ended and name in ends_with(service.joins))):
            return True
    return False


def tried(view: View, name: str) -> bool:
    """Return whether a new container of a service is on trial and has not come up, so the previous one may come
    back. Once it is back, nothing is on trial any more: the failed container is removed as soon as nothing is joined to
    it, so what is joined to it must not wait for it."""
    progress = view.s.memory.of(name)
    pair = candidate(view.of(name), progress.update)
    if pair is None or went_back(*pair):
        return False
    looked = view.s.observed.looked.get(pair[0].id)
    return not has_come_up(progress, view.desired.catalog.services[name], looked, view.now)


def _together(view: View, service: Service, other: str) -> bool:
    mine = service.update.atomic
    return mine in view.desired.sets and view.desired.catalog.services[other].update.atomic == mine


def _current(view: View, name: str) -> str:
    container = view.current(name)
    return container.id if container else ""


def _coming(view: View, service: Service, name: str) -> str:
    """Return the container that a service is about to have; "" if that is none but the current one. It is the previous
    one if the service goes back, or if a person took the change back; and the new one if it changes together with this
    service, because all new containers of a set are created before any is used."""
    update = view.s.memory.of(name).update
    pair = candidate(view.of(name), update)
    if pair is None:
        return ""
    new, old = pair
    taken_back = fits(old, name, view.desired) and not fits(new, name, view.desired)
    if update.failed or taken_back:
        return old.id
    return new.id if _together(view, service, name) else ""
