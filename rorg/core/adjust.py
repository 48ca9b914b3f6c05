"""In-place corrections of a container that is kept: its name, its live options, and a reload or restart if its files
changed.

Nothing here replaces a container; that is the job of reconcile.py.
"""

from __future__ import annotations

from collections.abc import Collection

from rorg.core.deferred import content_to_restart_for, deferred
from rorg.core.diff import Difference
from rorg.core.joining import tried
from rorg.core.memory import NO_ANSWER
from rorg.core.observed import Container
from rorg.core.operations import Rename, Signal, Update
from rorg.core.pressure import LOWERED_SHARES
from rorg.core.situation import View
from rorg.core.steps import Step, stop
from rorg.model.catalog import Service

DEFAULT_SHARES = 1024
"""CPU shares that Docker gives a container which declares no `cpu_shares`."""


def adjust(view: View, service: Service, container: Container, diff: Difference) -> list[Step]:
    """Return the steps that correct a kept container: options, name, reload signal, and at last a restart."""
    steps = []
    shares = _shares(view, service, container)
    live = {k: v for k, v in diff.live.items() if k != "cpu_shares" or service.name not in view.s.measures.lowered}
    if live:
        steps.append(Step(Update(container=container.id, options=live), "changed", tuple(sorted(live))))
    elif shares is not None and view.s.engine.update:
        why = "leaves the CPU to others" if shares == LOWERED_SHARES else "pressure is over"
        steps.append(Step(Update(container=container.id, options={"cpu_shares": shares}), why, ("cpu_shares",)))
    if (
        view.s.engine.rename
        and container.name != service.container_name
        and container.name != (name := _next_name(view, service))
    ):
        steps.append(Step(Rename(container=container.id, name=name), f"it is called {container.name}"))
    why = _restart(view, service, container)
    contents = view.desired.contents.get(service.name, {})
    if (
        container.state == "running"
        and service.name in view.s.wanted
        and service.on_change not in ("restart", "none")
        and (paths := view.s.memory.of(service.name).update.changed_content(container, contents))
    ):
        run = container.incarnation
        reload = Signal(container=container.id, signal=service.on_change, content=dict(contents), incarnation=run)
        steps.append(Step(reload, "changed", paths))
    if why:
        steps.append(stop(container, why, service))
    return steps


def _next_name(view: View, service: Service) -> str:
    """Return the name to take now: the service's own if it is free.

    Two services may have swapped names, so each container can be waiting for the name of the other. A temporary name
    breaks that cycle.
    """
    taken = any(c.name == service.container_name and c.service != service.name for c in view.all_containers)
    return passing_name(view, service) if taken else service.container_name


def passing_name(view: View, service: Service, taken: Collection[str] = ()) -> str:
    """Return a temporary name, unique per edition of the service and not in `taken`.

    `taken` matters if the container is replaced only because a container that it was joined to is gone: the new one has
    the same digest, and the old one is removed only after the new one exists.
    """
    name = f"{service.container_name}.{view.desired.digests[service.name].partition(':')[2][:8]}"
    return next(n for n in (name, *(f"{name}.{i}" for i in range(2, len(taken) + 3))) if n not in taken)


def _shares(view: View, service: Service, container: Container) -> int | None:
    """Return the CPU shares to set because of pressure or to restore after it; None to change nothing."""
    current = container.live.get("cpu_shares")
    if service.name in view.s.measures.lowered:
        return LOWERED_SHARES if container.active and current != LOWERED_SHARES else None
    declared = (service.spec or {}).get("cpu_shares", DEFAULT_SHARES)
    return declared if current == LOWERED_SHARES != declared else None


def _restart(view: View, service: Service, container: Container) -> str:
    """Return why the current run must end although its service is wanted; "" if it may go on."""
    if not container.alive or service.name not in view.s.wanted:
        return ""
    if view.s.restarts.get(service.name) == container.incarnation:
        return "restart requested"
    paths = content_to_restart_for(view, service, container)
    if paths and not deferred(view, service, paths):
        return f"changed: {', '.join(paths)}"
    return cannot_go_on(view, service, container)


def cannot_go_on(view: View, service: Service, container: Container) -> str:
    """Return why a run must end although no person and no change requires it: it hangs, or a need with `restart: true`
    was restarted. "" otherwise."""
    memory = view.s.memory.of(service.name)
    if memory.hung == container.incarnation:
        return memory.error or NO_ANSWER
    for need in service.restarts_with:
        current = view.current(need)
        # Wait until the need is ready: a program that shuts down often still talks to it, e.g. to unregister at the ROS
        # master.
        if (
            current
            and current.state == "running"
            and memory.counted_on.lost(need, container, current)
            and not view.has_actions(need)
            and view.s.memory.of(need).ready
            and not tried(view, need)
        ):
            return f"{need} was restarted"
    return ""
