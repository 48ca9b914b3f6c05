"""Steps of a service's chain, and groups of steps that always go together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from rorg.core.digest import declared_of
from rorg.core.memory import DEFAULT_GRACE
from rorg.core.observed import Container
from rorg.core.operations import Operation, Remove, Start, Stop
from rorg.core.plan import Part, Waiting
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
    signal, run = _signal(container, service, spec), container.incarnation
    return Step(Stop(container=container.id, signal=signal, grace=_grace(spec), incarnation=run), reason)


def _grace(spec: Mapping[str, Any]) -> float:
    """Return the grace period in seconds, checked because a label may contain anything."""
    grace = spec.get("stop_grace_period", DEFAULT_GRACE)
    return grace if isinstance(grace, int | float) and 0 <= grace <= LONGEST else DEFAULT_GRACE


def _signal(container: Container, service: Service | None, spec: Mapping[str, Any]) -> str:
    """Return the declared stop signal, or else the one that the engine reports, which may come from the image."""
    declared = spec.get("stop_signal")
    asked = service is not None and "stop_signal" not in service.defaults
    return str((declared if asked else None) or container.stop_signal or declared or "SIGTERM")
