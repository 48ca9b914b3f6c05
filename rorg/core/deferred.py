"""Reasons not to create a container now: a missing device, a missing image, or a deferred change."""

from __future__ import annotations

from collections.abc import Collection

from rorg.core.devices import NODES
from rorg.core.observed import Container
from rorg.core.plan import Waiting
from rorg.core.ros_parameters import due
from rorg.core.situation import View
from rorg.model.catalog import Service
from rorg.model.codes import CONFIRM, DEFERRED, DEVICE, IMAGE, NO_IMAGE, PARAMETERS
from rorg.model.volumes import SINGLE_FILE


def held_back(view: View, service: Service, changed: Collection[str]) -> Waiting | None:
    """Return why the desired container is not created now; None if nothing prevents it. `changed` are options in which
    the existing container differs."""
    if service.name in view.s.unplugged:
        return Waiting(service.name, view.s.unplugged[service.name], code=DEVICE)
    image = str(service.options.get("image", ""))
    missing = view.s.images.get(image)
    if missing:
        return Waiting(service.name, missing.text(image), code=NO_IMAGE if missing.failed else IMAGE)
    return deferred(view, service, changed)


def deferred(view: View, service: Service, changes: Collection[str]) -> Waiting | None:
    """Return why changed options or mounted paths are not applied yet; None if nothing defers them."""
    name = service.name
    if not changes or not view.active(name) or name not in view.s.wanted or name in view.s.restarts:
        return None
    names = ", ".join(sorted(changes))
    if service.update.when == "when_ceased":
        return Waiting(name, f"changed: {names}; takes effect when the service next idles or restarts", code=DEFERRED)
    driver = _driver_in_use(view, name) if set(changes) != {NODES} else ""
    if not driver:
        return None
    who = "" if driver == name else ", which restarts with it,"
    return Waiting(name, f"changed: {names}; {driver}{who} is in use; `rorg apply` confirms the change", code=CONFIRM)


def _driver_in_use(view: View, name: str) -> str:
    """Return a driver in use whose run a new run of this service would end: its own, or one of those that restart with
    it; "" if there is none.

    Hardware moves, or stops holding, when its driver ends. So an edit ends no driver that somebody uses before a person
    confirms it, as the paper asks before drivers are restarted by hand (ICRA 2019, IV).
    """
    desired, services = view.desired, view.desired.catalog.services
    names, seen = [name], {name}
    while names:
        other = names.pop()
        if services[other].update.when == "confirmed":
            view.mark_volatile()  # it depends on services that this one does not need
            if _is_in_use(view, other):
                return other
        for follower in desired.dependants.get(other, ()):
            follows = other in services[follower].restarts_with or other in services[follower].joins
            if follows and follower not in seen:
                seen.add(follower)
                names.append(follower)
    return ""


def _is_in_use(view: View, name: str) -> bool:
    """Return whether a wanted driver runs and does its work. One that fails may be mended immediately."""
    progress = view.s.memory.of(name)
    fails = progress.exits or progress.update.broken or progress.hung == progress.incarnation
    return name in view.s.wanted and name not in view.s.restarts and progress.ready and not fails


def content_to_restart_for(view: View, service: Service, container: Container) -> tuple[str, ...]:
    """Return mounted paths whose change must restart the current run. No signal tells it to read a single mounted
    file."""
    if service.on_change == "none" or not container.alive or service.name not in view.s.wanted:
        return ()
    now = view.desired.contents.get(service.name, {})
    changed = view.s.memory.of(service.name).update.changed_content(container, now)
    return changed if service.on_change == "restart" else tuple(p for p in changed if now[p].startswith(SINGLE_FILE))


def restarts_for_content(view: View, service: Service, container: Container) -> bool:
    """Return whether the current run ends only to read changed files. Nothing is wrong with it."""
    return service.name not in view.s.restarts and bool(content_to_restart_for(view, service, container))


def left_over(view: View, service: Service, container: Container) -> list[Waiting]:
    """Return what is not as declared although the container stays: changed files that wait for the next run, and ROS
    parameters that a running program does not take."""
    later = deferred(view, service, content_to_restart_for(view, service, container))
    why = view.s.memory.of(service.name).not_set if container.active and due(view.s, service) else ""
    refused = Waiting(service.name, f"its ROS parameters are not set: {why}", code=PARAMETERS) if why else None
    return [waiting for waiting in (later, refused) if waiting]
