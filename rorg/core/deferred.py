"""Reasons not to create a container now: a missing device, a missing image, or a deferred change."""

from __future__ import annotations

from collections.abc import Collection

from rorg.core.observed import Container
from rorg.core.plan import Waiting
from rorg.core.ros_parameters import due
from rorg.core.situation import View
from rorg.model.catalog import Service
from rorg.model.codes import DEVICE, IMAGE, NO_IMAGE, PARAMETERS


def held_back(view: View, service: Service, changed: Collection[str]) -> Waiting | None:
    """Return why the desired container is not created now; None if nothing prevents it. `changed` are options in which
    the existing container differs."""
    if service.name in view.s.unplugged:
        return Waiting(service.name, view.s.unplugged[service.name], code=DEVICE)
    image = str(service.options.get("image", ""))
    missing = view.s.images.get(image)
    if missing:
        return Waiting(service.name, f"image {image} {missing.reason}", code=NO_IMAGE if missing.failed else IMAGE)
    return deferred(view, service, changed)


def deferred(view: View, service: Service, changes: Collection[str]) -> Waiting | None:
    """Return why changed options or mounted paths are not applied yet; None if nothing defers them."""
    name = service.name
    if service.update.when != "when_ceased" or not changes or not view.active(name):
        return None
    if name not in view.s.wanted or name in view.s.restarts:
        return None
    names = ", ".join(sorted(changes))
    return Waiting(name, f"changed: {names}; takes effect when the service next idles or restarts", code="deferred")


def content_to_restart_for(view: View, service: Service, container: Container) -> tuple[str, ...]:
    """Return mounted paths whose change must restart the current run."""
    if service.on_change != "restart" or not container.alive or service.name not in view.s.wanted:
        return ()
    now = view.desired.contents.get(service.name, {})
    return view.s.memory.of(service.name).update.changed_content(container, now)


def left_over(view: View, service: Service, container: Container) -> list[Waiting]:
    """Return what is not as declared although the container stays: changed files that wait for the next run, and ROS
    parameters that a running program does not take."""
    later = deferred(view, service, content_to_restart_for(view, service, container))
    why = view.s.memory.of(service.name).not_set if container.active and due(view.s, service) else ""
    refused = Waiting(service.name, f"its ROS parameters are not set: {why}", code=PARAMETERS) if why else None
    return [waiting for waiting in (later, refused) if waiting]
