"""Steps of a service's chain, and those that always go together."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from rorg.core.digest import declared_of
from rorg.core.memory import DEFAULT_GRACE
from rorg.core.observed import Container
from rorg.core.operations import Operation, Remove, Start, Stop
from rorg.core.plan import Part
from rorg.model.catalog import Service
from rorg.model.units import LONGEST


@dataclass(frozen=True, slots=True)
class Step:
    """One operation of a service's chain that no gate has let through yet."""

    operation: Operation
    reason: str
    fields: tuple[str, ...] = ()
    part_of: Part = Part.NONE
    surplus: bool = False
    """See Action."""


def away(container: Container, reason: str, service: Service | None = None, volumes: bool = False) -> list[Step]:
    """Stop if it is alive, then remove; `volumes`: with what nobody named, and nobody will look for again."""
    if container.state == "removing":
        return []
    steps = [stop(container, reason, service)] if container.alive else []
    return [*steps, Step(Remove(container=container.id, volumes=volumes), reason)]


def restarting(container: Container | None, steps: list[Step]) -> list[Step]:
    """Steps that stop and start the same container are one restart."""
    if container and stops(container, steps) and any(isinstance(s.operation, Start) for s in steps):
        both = (Stop, Start)
        return [replace(s, part_of=Part.RESTART) if isinstance(s.operation, both) else s for s in steps]
    return steps


def stops(container: Container, steps: Iterable[Step]) -> bool:
    """Whether one of these steps ends the run of a container."""
    return any(isinstance(s.operation, Stop) and s.operation.container == container.id for s in steps)


def stop(container: Container, reason: str, service: Service | None) -> Step:
    """Ends a run with the signal and the time that its service, or else its own label, declares."""
    spec = (service.spec if service else None) or declared_of(container.declared)
    signal, run = _signal(container, service, spec), container.incarnation
    return Step(Stop(container=container.id, signal=signal, grace=_grace(spec), incarnation=run), reason)


def _grace(spec: Mapping[str, Any]) -> float:
    """Seconds; a label may say anything."""
    found = spec.get("stop_grace_period", DEFAULT_GRACE)
    return found if isinstance(found, int | float) and 0 <= found <= LONGEST else DEFAULT_GRACE


def _signal(container: Container, service: Service | None, spec: Mapping[str, Any]) -> str:
    """What was asked for; else what the engine says of this container, which may be its image's own."""
    declared = spec.get("stop_signal")
    asked = service is not None and "stop_signal" not in service.defaults
    return str((declared if asked else None) or container.stop_signal or declared or "SIGTERM")
