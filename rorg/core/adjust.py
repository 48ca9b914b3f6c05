"""What is set right on a container that stays: its name, its live options, what its run has read."""

from __future__ import annotations

from collections.abc import Callable, Collection

from rorg.core.content import changed
from rorg.core.deferred import content_to_restart_for, deferred
from rorg.core.diff import Difference
from rorg.core.joining import tried
from rorg.core.memory import NO_ANSWER
from rorg.core.observed import Container
from rorg.core.operations import Rename, Signal, Update
from rorg.core.pressure import LOWERED_SHARES
from rorg.core.steps import Step, stop
from rorg.core.view import View
from rorg.model.catalog import Service

DEFAULT_SHARES = 1024
"""What an engine gives a container that declares no cpu_shares."""


def adjust(
    view: View, service: Service, moving: Callable[[str], bool], container: Container, diff: Difference
) -> list[Step]:
    """Name and live options of the container that stays."""
    steps = []
    shares = _shares(view, service, container)
    live = {k: v for k, v in diff.live.items() if k != "cpu_shares" or service.name not in view.s.lowered}
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
    why, now = _restart(view, service, moving, container), view.desired.contents.get(service.name, {})
    if (
        container.state == "running"
        and service.name in view.s.wanted
        and service.on_change not in ("restart", "none")
        and (paths := changed(view.s.memory.of(service.name).update, container, now))
    ):
        run = container.incarnation
        told = Signal(container=container.id, signal=service.on_change, content=dict(now), incarnation=run)
        steps.append(Step(told, "changed", paths))
    if why:
        steps.append(stop(container, why, service))
    return steps


def _next_name(view: View, service: Service) -> str:
    """The name to take now: the service's own, or a passing one while another service's container has that, which
    may be waiting for the name of this one."""
    taken = any(c.name == service.container_name and c.service != service.name for c in view.all_containers)
    return passing_name(view, service) if taken else service.container_name


def passing_name(view: View, service: Service, taken: Collection[str] = ()) -> str:
    """One that no other edition of the service has, nor a container of this one, as `taken` says: that may be joined to
    what is gone, and is removed only after the new one is made."""
    name = f"{service.container_name}.{view.desired.digests[service.name].partition(':')[2][:8]}"
    return next(n for n in (name, *(f"{name}.{i}" for i in range(2, len(taken) + 3))) if n not in taken)


def _shares(view: View, service: Service, container: Container) -> int | None:
    """CPU shares to set because of pressure, or to put back after it; None for as they are."""
    now = container.live.get("cpu_shares")
    if service.name in view.s.lowered:
        return LOWERED_SHARES if container.active and now != LOWERED_SHARES else None
    declared = (service.spec or {}).get("cpu_shares", DEFAULT_SHARES)
    return declared if now == LOWERED_SHARES != declared else None


def _restart(view: View, service: Service, moving: Callable[[str], bool], container: Container) -> str:
    """Why the current run must end although the service is wanted; empty if it may go on."""
    if not container.alive or service.name not in view.s.wanted:
        return ""
    if view.s.restarts.get(service.name) == container.incarnation:
        return "restart requested"
    paths = content_to_restart_for(view, service, container)
    if paths and not deferred(view, service, paths):
        return f"changed: {', '.join(paths)}"
    return cannot_go_on(view, service, moving, container)


def cannot_go_on(view: View, service: Service, moving: Callable[[str], bool], container: Container) -> str:
    """What is wrong with a run that nobody asked to end: it hangs, or a need whose restart restarts it was restarted.
    Empty if nothing is."""
    memory = view.s.memory.of(service.name)
    if memory.hung == container.incarnation:
        return memory.error or NO_ANSWER
    for need in service.restarts_with:
        current = view.current(need)
        # Wait until the need is ready: what ends now may still want to say goodbye to it.
        if (
            current
            and current.state == "running"
            and memory.counted_on.lost(need, container, current)
            and not moving(need)
            and view.s.memory.of(need).ready
            and not tried(view, need)
        ):
            return f"{need} was restarted"
    return ""
