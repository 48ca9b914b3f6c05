"""All that a pass reads, in one value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rorg.core.cache import Cache
from rorg.core.desired import Desired
from rorg.core.dispatch import DispatchLimits
from rorg.core.memory import Memory, ProbeResults
from rorg.core.missing import Missing
from rorg.core.observed import Observed
from rorg.core.ros_graph import Graphs
from rorg.model.catalog import Hold, Request
from rorg.model.devices import Device, Plugged
from rorg.model.engines import Capabilities
from rorg.model.learned import Learned
from rorg.model.load import Load


@dataclass(frozen=True, slots=True, kw_only=True)
class Inputs:
    """What a pass reads. `requests`, `restarts`, `retries`, `holds` and `suspended` are those of the requests file;
    standing requests come with the catalog."""

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
    """Seconds since the epoch, for what people said `until`."""
    load: Load | None = None
    renewals: Mapping[tuple[str, str], int] = field(default_factory=dict)
    """The number of each request's last renewal; another one begins its lease anew."""
    asked: Mapping[str, float] = field(default_factory=dict)
    """Service -> since when somebody waits for it, by the clock of `now`: its readiness must have been told since."""
    confirmed: tuple[str, ...] = ()
    """What a person has confirmed to be removed, though it was named."""
    retries: Mapping[str, str] = field(default_factory=dict)
    """Service -> when somebody asked that what failed of it be tried again."""
    images: Mapping[str, Missing] = field(default_factory=dict)
    """By reference, those from which no container can be made now."""
    devices: Mapping[Device, Plugged] = field(default_factory=dict)
    """What there is of the devices of drivers; nothing is held back for want of one that is not among them."""
    ros: Graphs = field(default_factory=dict)
    """Graphs of ROS 1, as far as their masters answer."""
    down: bool = False
    """The robot is taken down: everything goes, and nothing is withheld."""
    purge: bool = False
    """A person has said that volumes of ours go too."""
    learned: Learned | None = None
    """What was learnt of requests before this loop began, which then goes on learning; None: nothing is prewarmed."""
    cache: Cache | None = None
    """Of the last pass; whatever has changed since is found anew."""
