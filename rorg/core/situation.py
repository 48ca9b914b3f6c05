"""Everything that a plan depends on, as one value."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from rorg.core.desired import Desired
from rorg.core.memory import Memory
from rorg.core.observed import Observed
from rorg.core.ros_graph import Graphs
from rorg.core.wanted import Wanted
from rorg.model.devices import Device, Plugged
from rorg.model.engines import Capabilities


@dataclass(frozen=True, slots=True)
class MissingImage:
    """An image that is not on this machine."""

    reason: str
    """How rorg obtains it, or why it cannot."""
    failed: bool = False
    """Whether waiting does not help."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """Everything that a plan depends on. `now` is the loop's monotonic clock in seconds; `restarts` maps services to
    the run that a requested restart must end."""

    desired: Desired
    wanted: Wanted
    urgent: frozenset[str]
    observed: Observed
    memory: Memory
    now: float
    owner: str
    engine: Capabilities = Capabilities()
    restarts: Mapping[str, str] = field(default_factory=dict)
    removals: bool = True
    """False while manifests do not load or declare no service: then nothing undeclared is removed, because an empty
    tree is more likely a mistake than an order."""
    confirmed: frozenset[str] = frozenset()
    """Services that are removed nevertheless, because a person confirmed it."""
    preempted: Mapping[str, str] = field(default_factory=dict)
    """Services that would be wanted if nothing stood against them -> the reason."""
    excluded: Collection[str] = frozenset()
    """Services that must not be active now, regardless of who requests them."""
    priorities: Mapping[str, int] = field(default_factory=dict)
    """Effective priority of every wanted service (see admission.py)."""
    interlocks: Mapping[str, str] = field(default_factory=dict)
    """Service -> why its interlock refuses; "" if it may be touched now."""
    lowered: frozenset[str] = frozenset()
    """Services that leave the CPU to others."""
    hurry: bool = False
    """Whether nothing lingers."""
    stop_paused: bool = False
    """Whether unwanted paused services are stopped."""
    shed: frozenset[str] = frozenset()
    """Services that must free what they use, so pausing is not enough."""
    closed: str = ""
    """Why nothing with a priority below `admit` is started now; "" if everything may be."""
    suspended: str = ""
    """Why rorg does nothing at all now."""
    images: Mapping[str, MissingImage] = field(default_factory=dict)
    """Image reference -> why no container can be made from it now."""
    devices: Mapping[Device, Plugged] = field(default_factory=dict)
    """State of drivers' devices, as far as known."""
    unplugged: Mapping[str, str] = field(default_factory=dict)
    """Services that lack a device now, each with the reason."""
    ros: Graphs = field(default_factory=dict)
    """Graphs of ROS 1 masters."""
    purge: bool = False
    """Volumes are removed with all their data: the robot is taken down and a person ordered it."""
    prewarmed: frozenset[str] = frozenset()
    """Services that are wanted only because a request is likely, and those they need."""
    withheld: Mapping[str, str] = field(default_factory=dict)
    """Undeclared services that stay until a person confirms their removal, each with the reason."""
