"""Links of a service's chain, and the ones that always go together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from rorg.core.digest import declared_of
from rorg.core.memory import DEFAULT_GRACE
from rorg.core.observed import Container
from rorg.model.catalog import Service
from rorg.model.units import LONGEST


@dataclass(frozen=True, slots=True)
class Step:
    """One link of a service's chain, not yet let through."""

    verb: str
    container: Container | None
    reason: str
    fields: tuple[str, ...] = ()
    args: Mapping[str, Any] = field(default_factory=dict)
    part_of: str = ""
    surplus: bool = False
    """See Action."""


def away(container: Container, reason: str, service: Service | None = None, volumes: bool = False) -> list[Step]:
    """Stop if it is alive, then remove; `volumes`: with what nobody named, and nobody will look for again."""
    if container.state == "removing":
        return []
    steps = [stop(container, reason, service)] if container.alive else []
    return [*steps, Step("remove", container, reason, args={"volumes": True} if volumes else {})]


def restarting(container: Container | None, steps: list[Step]) -> list[Step]:
    """Steps that stop and start the same container are one restart."""
    if (
        container
        and any(s.verb == "stop" and s.container is container for s in steps)
        and any(s.verb == "start" for s in steps)
    ):
        return [replace(s, part_of="restart") if s.verb in ("stop", "start") else s for s in steps]
    return steps


def stop(container: Container, reason: str, service: Service | None) -> Step:
    """Ends a run with the signal and the time that its service, or else its own label, declares."""
    spec = (service.spec if service else None) or declared_of(container.declared)
    return Step(
        "stop",
        container,
        reason,
        args={
            "signal": _signal(container, service, spec),
            "grace": _grace(spec),
            "incarnation": container.incarnation,
        },
    )


def _grace(spec: Mapping[str, Any]) -> float:
    """Seconds; a label may say anything."""
    found = spec.get("stop_grace_period", DEFAULT_GRACE)
    return found if isinstance(found, int | float) and 0 <= found <= LONGEST else DEFAULT_GRACE


def _signal(container: Container, service: Service | None, spec: Mapping[str, Any]) -> str:
    """What was asked for; else what the engine says of this container, which may be its image's own."""
    declared = spec.get("stop_signal")
    asked = service is not None and "stop_signal" not in service.defaults
    return str((declared if asked else None) or container.stop_signal or declared or "SIGTERM")
