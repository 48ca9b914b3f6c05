"""Everything that a pass reads, as one value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rorg.core.dispatch import DispatchLimits
from rorg.core.holds import Moment
from rorg.core.incremental import Planned
from rorg.core.memory import ProbeResults
from rorg.core.schedule import Schedule
from rorg.core.situation import Surroundings
from rorg.core.tracking import Tracked
from rorg.model.catalog import Hold, Request
from rorg.model.load import Load


@dataclass(frozen=True, slots=True, kw_only=True)
class Cache:
    """Results of the last pass for the next one to continue from. Each part records what it was derived from; without a
    cache everything is derived again, with the same result."""

    tracked: Tracked
    planned: Planned
    schedule: Schedule


@dataclass(frozen=True, slots=True, kw_only=True)
class Inputs(Surroundings):
    """What a pass reads. `requests`, `restarts`, `retries`, `holds` and `suspended` come from the requests file;
    requests that manifests declare come with the catalog."""

    requests: tuple[Request, ...]
    restarts: Mapping[str, str]
    results: ProbeResults
    limits: DispatchLimits = DispatchLimits()
    holds: Mapping[str, Hold] = field(default_factory=dict)
    suspended: Hold | None = None
    wall: float = 0.0
    """Seconds since the epoch, for times that people gave."""
    boot: str = ""
    """Id of the machine's boot."""
    load: Load | None = None
    renewals: Mapping[tuple[str, str], int] = field(default_factory=dict)
    """Number of each request's last renewal; a new number starts its lease again."""
    asked: Mapping[str, float] = field(default_factory=dict)
    """Service -> since when someone waits for it, by the clock of `now`. Only readiness observed after that counts for
    them."""
    confirmed: tuple[str, ...] = ()
    """Removals that a person has confirmed."""
    retries: Mapping[str, str] = field(default_factory=dict)
    """Service -> when someone asked to retry what failed."""
    down: bool = False
    """`rorg down`: everything goes, and nothing is withheld."""
    cache: Cache | None = None
    """From the last pass."""

    @property
    def moment(self) -> Moment:
        """The present, by all clocks."""
        return Moment(self.wall, self.now, self.boot)
