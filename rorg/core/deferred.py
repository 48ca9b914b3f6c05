"""Changes that wait until a service is ceased or restarted, since its manifest or the Policy says so."""

from __future__ import annotations

from collections.abc import Collection

from rorg.core.content import changed
from rorg.core.observed import Container
from rorg.core.plan import Waiting
from rorg.core.view import View
from rorg.model.catalog import Service


def deferred(view: View, service: Service, changes: Collection[str]) -> Waiting | None:
    """Why what has changed of it (options, or mounted paths) is not in use yet; None where nothing keeps it back."""
    name = service.name
    if service.update.when != "when_ceased" or not changes or not view.active(name):
        return None
    if name not in view.s.wanted or name in view.s.restarts:
        return None
    what = ", ".join(sorted(changes))
    return Waiting(name, f"changed: {what}; comes into use when it is next ceased or restarted", code="deferred")


def content_to_restart_for(view: View, service: Service, container: Container) -> tuple[str, ...]:
    """Mounted paths for whose change its run is to end."""
    if service.on_change != "restart" or not container.alive or service.name not in view.s.wanted:
        return ()
    now = view.desired.contents.get(service.name, {})
    return changed(view.s.memory.of(service.name).update, container, now)
