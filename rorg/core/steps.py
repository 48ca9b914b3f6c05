"""Steps of a service's chain: groups of steps that always go together, and the in-place corrections of a container that
is kept: its name, its live options, and a reload or restart if its files changed. Nothing here replaces a container;
that is the job of reconcile.py."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from rorg.core.deferred import content_to_restart_for, deferred
from rorg.core.diff import Difference
from rorg.core.digest import declared_of
from rorg.core.joining import tried
from rorg.core.memory import DEFAULT_GRACE, NO_ANSWER
from rorg.core.observed import PROCESS_GONE, Container
from rorg.core.operations import Activate, Operation, Remove, Rename, Resume, Signal, Start, Stop, Update
from rorg.core.plan import Part, Waiting
from rorg.core.pressure import LOWERED_SHARES
from rorg.core.situation import View
from rorg.model.catalog import Service
from rorg.model.units import LONGEST


@dataclass(frozen=True, slots=True)
class Step:
    """One operation of a service's chain, before the gates (gates.py) have checked it."""

    operation: Operation
    reason: str
    fields: tuple[str, ...] = ()
    part_of: Part = Part.NONE
    surplus: bool = False
    """See Action."""
    after: tuple[str, ...] = ()
    """Services whose actions must come first, besides what the gates find."""


@dataclass(frozen=True, slots=True)
class Chain:
    """What leads a service, network or volume from what is observed to what is desired. `notes` hold nothing back but
    are reported; `alarm` is when something is due that no waiting mentions; with `waiting` nothing can be done now."""

    steps: Sequence[Step] = ()
    notes: Sequence[Waiting] = ()
    alarm: float | None = None
    waiting: Waiting | None = None


def away(container: Container, reason: str, service: Service | None = None, volumes: bool = False) -> list[Step]:
    """Return the steps that stop and remove a container. `volumes` also removes anonymous volumes, which nothing will
    use again."""
    if container.state == "removing":
        return []
    steps = [stop(container, reason, service)] if container.alive else []
    return [*steps, Step(Remove(container=container.id, volumes=volumes), reason)]


def restarting(container: Container | None, steps: list[Step]) -> list[Step]:
    """Mark steps that stop and start the same container as one restart."""
    if container and stops(container, steps) and any(isinstance(s.operation, Start) for s in steps):
        both = (Stop, Start)
        return [replace(s, part_of=Part.RESTART) if isinstance(s.operation, both) else s for s in steps]
    return steps


def stops(container: Container, steps: Iterable[Step]) -> bool:
    """Return whether one of these steps ends the container's run."""
    return any(isinstance(s.operation, Stop) and s.operation.container == container.id for s in steps)


def stop(container: Container, reason: str, service: Service | None) -> Step:
    """Return the step that ends a run, with signal and grace period from the manifest, or from the container's label if
    there is no manifest."""
    spec = (service.spec if service else None) or declared_of(container.declared)
    signal, run, resumes = _signal(container, service, spec), container.incarnation, container.state == "paused"
    ended = Stop(container=container.id, signal=signal, grace=_grace(spec), incarnation=run, resumes=resumes)
    return Step(ended, reason)


def kill(container: Container, reason: str) -> Step:
    """Return the step that ends a paused run without resuming it.

    Measured: its first process runs no more. Its other processes run for 17 ms at most with Docker 20.10, and for 7 ms
    with Podman 4.3 (both with control groups v1: the kernel delivers the signal when the engine thaws them), and with
    the process engine not at all.
    """
    return Step(Stop(container=container.id, signal="SIGKILL", grace=0.0, incarnation=container.incarnation), reason)


def _grace(spec: Mapping[str, Any]) -> float:
    """Return the grace period in seconds, checked because a label may contain anything."""
    grace = spec.get("stop_grace_period", DEFAULT_GRACE)
    return grace if isinstance(grace, int | float) and 0 <= grace <= LONGEST else DEFAULT_GRACE


def _signal(container: Container, service: Service | None, spec: Mapping[str, Any]) -> str:
    """Return the declared stop signal, or else the one that the engine reports, which may come from the image."""
    declared = spec.get("stop_signal")
    asked = service is not None and "stop_signal" not in service.defaults
    return str((declared if asked else None) or container.stop_signal or declared or "SIGTERM")


def awaken(service: Service, container: Container, reason: str) -> list[Step]:
    """Return the step by which a run goes on that is paused, or whose managed nodes are not active."""
    if container.state == "paused":
        return [Step(Resume(container=container.id), reason)]
    if service.domain is None or not service.managed:
        return []
    return [Step(Activate(container=container.id, nodes=service.managed, domain=service.domain), reason)]


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
    if why:
        return [*steps, stop(container, why, service)]
    return [*steps, *_reload(view, service, container)]


def _reload(view: View, service: Service, container: Container) -> list[Step]:
    """Return the step that tells a run to read its changed files, if a signal does that."""
    if container.state != "running" or service.name not in view.s.wanted or service.on_change in ("restart", "none"):
        return []
    contents, update = view.desired.contents.get(service.name, {}), view.s.memory.of(service.name).update
    later = content_to_restart_for(view, service, container)
    paths = tuple(p for p in update.changed_content(container, contents) if p not in later)
    read = {path: update.content.get(path, digest) if path in later else digest for path, digest in contents.items()}
    reload = Signal(container=container.id, signal=service.on_change, content=read, incarnation=container.incarnation)
    return [Step(reload, "changed", paths)] if paths else []


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


def free_name(view: View, service: Service, stale: Sequence[Container]) -> str:
    """Return the service's name, or a temporary one while an older container has it."""
    names = [c.name for c in stale]
    return passing_name(view, service, names) if service.container_name in names else service.container_name


def make_room(view: View, service: Service, old: Container) -> list[Step]:
    """Return the step that gives an old container a temporary name, because the new one takes the service's."""
    if old.name != service.container_name or not view.s.engine.rename:
        return []
    name = f"{service.container_name}.{old.digest.partition(':')[2][:8] or old.id[:8]}"
    if name in {c.name for c in view.of(service.name)}:  # the new one has the same digest
        name = f"{name}.{old.id[:8]}"
    return [Step(Rename(container=old.id, name=name), "changed")]


def _shares(view: View, service: Service, container: Container) -> int | None:
    """Return the CPU shares to set because of pressure or to restore after it; None to change nothing."""
    current = container.live.get("cpu_shares")
    if service.name in view.s.measures.lowered:
        return LOWERED_SHARES if container.active and current != LOWERED_SHARES else None
    declared = service.options.get("cpu_shares", DEFAULT_SHARES)
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
    if container.vanished:
        return PROCESS_GONE
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
            and (not view.unready(need) if need in view.s.peers.remotes else view.s.memory.of(need).ready)
            and not tried(view, need)
        ):
            return f"{need} was restarted"
    return ""
