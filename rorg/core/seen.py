"""What a pass observes of one service."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from rorg.core.memory import ProbeResult
from rorg.core.observed import Container


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """What a pass observes of one service.

    - `containers`: those of all services, the current one of each first;
    - `ready`, `live`: its probe results;
    - `busy`: an engine call on it is under way;
    - `unplugged`: a device of it is missing;
    - `now`: the loop's clock, in seconds;
    - `looked`: as in Observed.
    """

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
        """Return whether a look at the container began after that moment."""
        return self.looked.get(container.id, -1.0) >= moment
