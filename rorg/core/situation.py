"""Everything that a plan depends on: the situation, and the planner's view of it while it plans one service. The view
records until when the plan holds, and whether it depends on all containers, so that it is made again when necessary."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from math import inf

from rorg.core.desired import Desired
from rorg.core.digest import rules_of
from rorg.core.memory import Memory
from rorg.core.observed import Container, Observed
from rorg.core.peers import NOBODY, Peers
from rorg.core.plan import Reason, ServicePlan
from rorg.core.probes_in_force import with_probes_in_force
from rorg.core.ros_graph import Graphs
from rorg.core.wanted import Wanted
from rorg.model.catalog import Service
from rorg.model.devices import Device, Plugged
from rorg.model.engines import Capabilities


@dataclass(frozen=True, slots=True)
class MissingImage:
    """An image that is not on this machine."""

    reason: str = ""
    """How rorg obtains it, or why it cannot, after its name; empty while rorg checks whether it is here."""
    failed: bool = False
    """Whether waiting does not help."""

    def text(self, image: str) -> str:
        """Return the reason with the name of the image."""
        return f"image {image} {self.reason}" if self.reason else f"checking for image {image}"


@dataclass(frozen=True, slots=True)
class Measures:
    """The measures against pressure that are in force."""

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Surroundings:
    """What a pass reads and its plan depends on. `now` is the loop's monotonic clock in seconds."""

    desired: Desired
    observed: Observed
    memory: Memory
    now: float
    owner: str
    engine: Capabilities = Capabilities()
    removals: bool = True
    """False while manifests do not load or declare no service: then nothing undeclared is removed, because an empty
    tree is more likely a mistake than an order."""
    images: Mapping[str, MissingImage] = field(default_factory=dict)
    """Image reference -> why no container can be made from it now."""
    devices: Mapping[Device, Plugged] = field(default_factory=dict)
    """State of drivers' devices, as far as known. A device that is not listed holds nothing back."""
    ros: Graphs = field(default_factory=dict)
    """Graphs of the ROS 1 masters that answer, and of the ROS 2 domains that are reported."""
    unreported: Mapping[str, float] = field(default_factory=dict)
    """Graphs of ROS 2 with managed nodes that nothing reports -> since when."""
    unsettled: frozenset[str] = frozenset()
    """Mounted paths of the tree, as in Desired.contents, that are being written and were not read yet."""
    peers: Peers = NOBODY
    """The other machines of the robot."""
    purge: bool = False
    """Volumes are removed with all their data: the robot is taken down and a person ordered it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Situation(Surroundings):
    """Everything that a plan depends on."""

    wanted: Wanted
    urgent: frozenset[str]
    restarts: Mapping[str, str] = field(default_factory=dict)
    """Service -> the run that a requested restart must end."""
    confirmed: frozenset[str] = frozenset()
    """Services that are removed even without `removals`, because a person confirmed it."""
    preempted: Mapping[str, str] = field(default_factory=dict)
    """Services that would be wanted if nothing stood against them -> the reason."""
    rivals: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Preempted services -> the active services that have what they wait for, if that is the reason."""
    asked: Wanted = field(default_factory=dict)
    """What would be wanted if nothing stood against anything; empty if nothing is preempted."""
    excluded: Collection[str] = frozenset()
    """Services that must not be active now, regardless of who requests them."""
    priorities: Mapping[str, int] = field(default_factory=dict)
    """Effective priority of every wanted service (see admission.py)."""
    interlocks: Mapping[str, str] = field(default_factory=dict)
    """Service -> why its interlock refuses; "" if it may be touched now."""
    measures: Measures = Measures()
    suspended: str = ""
    """Why rorg does nothing at all now."""
    unplugged: Mapping[str, str] = field(default_factory=dict)
    """Services that lack a device now, each with the reason."""
    withheld: Mapping[str, str] = field(default_factory=dict)
    """Undeclared services that stay until a person confirms their removal, each with the reason."""

    def with_probes_in_force(self, name: str) -> Service:
        """Return a declared service with the probes that its present container must answer."""
        service, current = self.desired.catalog.services[name], self.observed.current(name)
        return with_probes_in_force(service, self.memory.of(name).update, current, self.desired)

    def over(self, name: str) -> bool:
        """Return whether a service ended and its restart policy does not restart it."""
        current = self.observed.current(name)
        return current is not None and self.memory.of(name).over(self.desired.catalog.services[name], current)

    def completed(self, name: str) -> bool:
        """Return whether it is a task that ended with exit code 0."""
        current = self.observed.current(name)
        return current is not None and current.exit_code == 0 and self.over(name)

    def starting(self, service: str) -> bool:
        """Return whether a call is under way that makes the service active."""
        flight = self.memory.in_flight.get(service)
        return flight is not None and flight.action.operation.begins


class Exclusive:
    """Holders of exclusive resources in one situation. `undeclared` are containers of services that no manifest
    declares, or that are declared without a container."""

    def __init__(self, situation: Situation, undeclared: Mapping[str, Sequence[Container]]) -> None:
        self.s, self.desired, self.undeclared = situation, situation.desired, undeclared
        self.capacity = situation.desired.catalog.policy.resources

    def holders(self, service: Service, resource: str, runs: Callable[[str], bool]) -> list[str]:
        """Return the services that must let go of a resource before this service can run. `runs` says which services
        run because of the same plan: they hold it as well."""
        users = [o for o in self.desired.sharers[resource] if o != service.name and (self.alive(o) or runs(o))]
        left_over = self.left_over(resource)
        used = service.exclusive[resource] + sum(self.units(o, resource) for o in users) + sum(left_over.values())
        if used <= self.capacity.get(resource, 1):
            return []
        return [*(o for o in users if o not in self.s.wanted), *left_over] or users

    def contested(self, service: Service) -> bool:
        """Return whether this service holds a resource, even while paused, that wanted services need."""
        for resource, units in service.exclusive.items():
            sharers = [o for o in self.desired.sharers[resource] if o != service.name]
            needed_by = {o for o in sharers if o in self.s.wanted and not self.s.over(o)}
            users = [o for o in sharers if o in needed_by or self.alive(o)]
            used = units + sum(self.units(o, resource) for o in users) + sum(self.left_over(resource).values())
            if needed_by and used > self.capacity.get(resource, 1):
                return True
        return False

    def left_over(self, resource: str) -> dict[str, int]:
        """Return undeclared services that still hold units of a resource -> how many."""
        return {
            name: units
            for name, cs in self.undeclared.items()
            if self.alive(name) and (units := rules_of(cs[0].rules).exclusive.get(resource, 0))
        }

    def units(self, name: str, resource: str) -> int:
        return self.desired.catalog.services[name].exclusive[resource]

    def alive(self, name: str) -> bool:
        """Return whether a service holds its resources, or will as soon as a call under way has its effect."""
        return self.s.starting(name) or any(c.alive for c in self.s.observed.of(name))


class View:
    """A situation, seen from one service, network or volume. Its plan may depend on itself, on related services (see
    depending_plans in incremental.py) and on the plans before it in order. Reading `now` or `all_containers` adds a
    dependency on everything and marks the plan as `volatile`; has_come() makes it hold `until` a moment.

    - `earlier`: returns the plan of a service that comes before this one, and an empty plan for every other, so that
      the result does not depend on the order of planning within a pass;
    - `hurry`: it does not linger.
    """

    def __init__(
        self, situation: Situation, exclusive: Exclusive, earlier: Callable[[str], ServicePlan], hurry: bool
    ) -> None:
        self.s, self.desired, self.exclusive = situation, situation.desired, exclusive
        self.earlier, self.hurry = earlier, hurry
        self.of, self.current = situation.observed.of, situation.observed.current
        self.volatile, self.until = False, inf

    def has_come(self, moment: float) -> bool:
        """Return whether a moment has come. The plan must be made again when it comes."""
        if moment <= self.s.now:
            return True
        self.until = min(self.until, moment)
        return False

    def mark_volatile(self) -> None:
        """Let this plan be made again in every pass, because it depends on more than incremental planning knows."""
        self.volatile = True

    @property
    def now(self) -> float:
        self.volatile = True
        return self.s.now

    @property
    def all_containers(self) -> Sequence[Container]:
        self.volatile = True
        return self.s.observed.containers

    def active(self, service: str) -> bool:
        """Return whether a service runs, or a call under way makes it run, even if only to end."""
        own, flight = self.of(service), self.s.memory.in_flight.get(service)
        if flight is None or any(c.active for c in own):
            return any(c.active for c in own)
        # A person may have paused the run since: it is resumed to end.
        return flight.action.runs or (flight.action.asks_to_end and any(c.state == "paused" for c in own))

    def has_actions(self, name: str) -> bool:
        """Return whether the plan before this one has actions for a service."""
        return bool(self.earlier(name).actions)

    def runs(self, name: str) -> bool:
        """Return whether a service runs because of the plan before this one, even if only to end."""
        return self.earlier(name).runs

    def unready(self, name: str) -> Reason:
        """Return why a service is not ready and the plan will not change that; "" otherwise."""
        service = self.desired.catalog.services.get(name)
        if service is None:
            return "is not declared"
        if service.away:
            return self.s.peers.unready(service)
        return "" if service.meta else self.earlier(name).unready
