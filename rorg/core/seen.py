"""What one look at a service sees of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from rorg.core.memory import ProbeResult
from rorg.core.observed import Container


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """`containers` are those of all services, of each the one that counts first; `ready` and `live` are its probe
    results; `busy`: a call of it is under way; `unplugged`: a device of it is not there; `now` is of the loop's
    clock, seconds; `looked` is that of Observed."""

    wanted: bool
    containers: Mapping[str, Sequence[Container]]
    ready: ProbeResult | None
    live: ProbeResult | None
    busy: bool
    now: float
    booted_at: str
    unplugged: bool = False
    looked: Mapping[str, float] = field(default_factory=dict)

    def current(self, service: str) -> Container | None:
        return next(iter(self.containers.get(service, ())), None)

    def looked_since(self, container: Container, moment: float) -> bool:
        """Whether a look at a container has begun since."""
        return self.looked.get(container.id, -1.0) >= moment
