"""All that a plan depends on, in one value."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from rorg.core.desired import Desired
from rorg.core.memory import Memory
from rorg.core.missing import Missing
from rorg.core.observed import Observed
from rorg.core.ros_graph import Graphs
from rorg.core.wanted import Wanted
from rorg.model.devices import Device, Plugged
from rorg.model.engines import Capabilities


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation:
    """All that a plan depends on. `now` is the loop's monotonic clock in seconds; `restarts` holds, for each service
    that somebody asked to restart, the run that is to end by it."""

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
    """False while manifests do not load, or declare no service: then nothing that they do not name is removed."""
    confirmed: frozenset[str] = frozenset()
    """What goes nevertheless, since a person has said so."""
    preempted: Mapping[str, str] = field(default_factory=dict)
    """Services that would be wanted but for something, each with the reason."""
    excluded: Collection[str] = frozenset()
    """Services that must not be active now, whoever asks."""
    priorities: Mapping[str, int] = field(default_factory=dict)
    """How much each wanted service matters (see admission)."""
    interlocks: Mapping[str, str] = field(default_factory=dict)
    """Services with an interlock: empty text where it allows touching them now, else why not."""
    lowered: frozenset[str] = frozenset()
    """Services that are to leave the CPU to others."""
    hurry: bool = False
    """Nothing lingers."""
    stop_paused: bool = False
    """What is paused and not wanted is stopped."""
    shed: frozenset[str] = frozenset()
    """Services that must free what they use: pausing them is not enough."""
    closed: str = ""
    """Why nothing below `admit` is started now; empty when everything may be."""
    suspended: str = ""
    """Why nothing is done at all now."""
    images: Mapping[str, Missing] = field(default_factory=dict)
    """By reference, those from which no container can be made now."""
    devices: Mapping[Device, Plugged] = field(default_factory=dict)
    """What there is of the devices of drivers, as far as it is known."""
    unplugged: Mapping[str, str] = field(default_factory=dict)
    """Services of which a device cannot be used now, each with why."""
    ros: Graphs = field(default_factory=dict)
    """Graphs of ROS 1."""
    purge: bool = False
    """Volumes of ours go too, with all that is in them: the robot is taken down, and a person has said so."""
    prewarmed: frozenset[str] = frozenset()
    """Services that are wanted only since it is likely that they will be requested soon, and what these need."""
    withheld: Mapping[str, str] = field(default_factory=dict)
    """What no manifest declares any more and stays until a person has confirmed that it goes, each with the reason."""
