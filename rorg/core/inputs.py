"""Everything that a pass reads, as one value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rorg.core.desired import Desired
from rorg.core.dispatch import DispatchLimits
from rorg.core.incremental import Planned
from rorg.core.memory import Memory, ProbeResults
from rorg.core.observed import Observed
from rorg.core.ros_graph import Graphs
from rorg.core.schedule import Schedule
from rorg.core.situation import MissingImage
from rorg.core.tracking import Tracked
from rorg.model.catalog import Hold, Request
from rorg.model.devices import Device, Plugged
from rorg.model.engines import Capabilities
from rorg.model.learned import Learned
from rorg.model.load import Load


@dataclass(frozen=True, slots=True, kw_only=True)
class Cache:
    """Results of the last pass for the next one to continue from. Each part records what it was derived from; without a
    cache everything is derived again, with the same result."""

    tracked: Tracked
    planned: Planned
    schedule: Schedule


@dataclass(frozen=True, slots=True, kw_only=True)
class Inputs:
    """What a pass reads. `requests`, `restarts`, `retries`, `holds` and `suspended` come from the requests file;
    requests that manifests declare come with the catalog."""

    desired: Desired
    requests: tuple[Request, ...]
    restarts: Mapping[str, str]
    observed: Observed
    results: ProbeResults
    memory: Memory
    now: float
    owner: str
    engine: Capabilities = Capabilities()
    removals: bool = True
    booted_at: str = ""
    limits: DispatchLimits = DispatchLimits()
    holds: Mapping[str, Hold] = field(default_factory=dict)
    suspended: Hold | None = None
    wall: float = 0.0
    """Seconds since the epoch, for times that people gave."""
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
    images: Mapping[str, MissingImage] = field(default_factory=dict)
    """Image reference -> why no container can be made from it now."""
    devices: Mapping[Device, Plugged] = field(default_factory=dict)
    """State of drivers' devices. A device that is not listed holds nothing back."""
    ros: Graphs = field(default_factory=dict)
    """Graphs of the ROS 1 masters that answer."""
    down: bool = False
    """`rorg down`: everything goes, and nothing is withheld."""
    purge: bool = False
    """A person has ordered that rorg's volumes go too."""
    learned: Learned | None = None
    """The model learnt from requests before this loop began, which it extends; None turns prewarming off."""
    cache: Cache | None = None
    """From the last pass."""
