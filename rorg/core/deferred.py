"""Changes that wait until a service idles or restarts: `update: {when: when_ceased}` in its manifest or in the
Policy."""

from __future__ import annotations

from collections.abc import Collection

from rorg.core.content import changed
from rorg.core.observed import Container
from rorg.core.plan import Waiting
from rorg.core.view import View
from rorg.model.catalog import Service


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
    return changed(view.s.memory.of(service.name).update, container, now)
