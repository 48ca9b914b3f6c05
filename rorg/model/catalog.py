"""Everything that a tree of manifests declares, frozen: the input of all decisions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any

from rorg.model.devices import Device
from rorg.model.diagnostics import Where
from rorg.model.machines import Machine
from rorg.model.objects import EngineObject
from rorg.model.policy import Policy
from rorg.model.probe import Probe
from rorg.model.ros import RosParameters

DEVELOPER = "developer"
"""The built-in meta-service: a person. It is always active, so its requests stay until they are released."""

EVERY = "*"
"""In `may_act_for`: every service, except developer."""

HIGHEST_PRIORITY = 100
"""Of a service or request; the lowest is 0."""

SHORTEST_SECRET = 6
"""Minimum number of characters of a secret that is masked in texts; a shorter one occurs in any text."""

Spec = Mapping[str, Any]
"""A rendered container: `image`, `command` and options under Compose's names, in plain JSON values; only what is
declared. Exactly this is sent to the engine and digested."""


@dataclass(frozen=True, slots=True)
class Idle:
    """The action for a service that is not wanted."""

    action: str = "stop"
    """pause, deactivate, stop or remove."""
    linger: float = 0.0
    """Seconds for which a service stays active after it is no longer wanted."""
    min_active: float = 0.0
    """Minimum seconds for which it stays active after a start or resume."""
    escalate: tuple[float, str] | None = None
    """(seconds after it became idle; pause, stop or remove)."""
    reclaim: bool = False
    connected: str = "pause"
    """pause or stop: what to do instead of pausing it while its ROS nodes are connected to those of other services."""

    @property
    def keeps_run(self) -> bool:
        """Whether its run goes on while it is idle."""
        return self.action in ("pause", "deactivate")


@dataclass(frozen=True, slots=True)
class Updating:
    """How a change of a service is rolled out."""

    when: str = "now"
    """now; when_ceased: when it is next idle or restarted; confirmed: also when it fails, or a person confirms it."""
    bake: float = 2.0
    """Seconds for which it must stay well after it is ready, before the previous container is removed."""
    atomic: str = ""
    """The set of services that change together, or go back together; empty for none."""


@dataclass(frozen=True, slots=True)
class Service:
    """One service, with everything that profiles and the Policy add to its manifest."""

    name: str
    meta: bool = False
    machine: str = ""
    """Its computer; "" if the robot has only one, and for a meta-service."""
    away: str = ""  # the same if that is another computer; it has no spec then
    always_on: bool = False
    needs: tuple[str, ...] = ()
    """Names of services; groups are already replaced by their members."""
    restarts_with: tuple[str, ...] = ()
    """Members of `needs` whose restart restarts this service."""
    joins: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Service in `needs` -> options by which this container uses its namespaces or volumes (see joining.py)."""
    conflicts: tuple[str, ...] = ()
    exclusive: Mapping[str, int] = field(default_factory=dict)
    """Resource -> units."""
    may_request: tuple[str, ...] = ()
    """Services and groups that it may request through the API."""
    may_restart: tuple[str, ...] = ()
    """Services and groups that it may restart."""
    may_act_for: tuple[str, ...] = ()
    """Services for which it may act, as a bridge does for its callers; `*` is every service except developer."""
    may_manage: tuple[str, ...] = ()
    """Patterns of names of services that it may create, change and remove."""
    may_report_graph: bool = False
    """It may report the graph of ROS 2."""
    idle: Idle = Idle()
    update: Updating = Updating()
    ready: Probe | None = None
    live: Probe | None = None
    interlock: Probe | None = None
    """The check that must succeed before rorg touches a container of this service; None if there is none."""
    protected: bool = False
    restart: str = "always"
    """always, on-failure or never."""
    on_change: str = "restart"
    """The reaction to changes of files that it mounts from the tree: restart, none, or the name of a signal."""
    priority: int = 50
    cpu: float = 0.0
    """Expected use, cores."""
    memory: int = 0
    """Expected use, bytes."""
    driver: bool = False
    devices: tuple[Device, ...] = ()
    """Devices without which it does not run."""
    unplugged: str = "stop"
    """The reaction when one of them is unplugged: stop or keep."""
    ros: RosParameters | None = None
    domain: int | None = None
    """ROS 2 domain; None for anything but a program of ROS 2."""
    managed: tuple[str, ...] = ()
    """Nodes of ROS 2 whose life cycle rorg manages, in order of activation."""
    spec: Spec | None = None
    """None for a meta-service."""
    secrets: tuple[str, ...] = ()
    """Variables of its environment with secret values: declared as such, or from a file of variables."""
    defaults: tuple[str, ...] = ()
    """Options in the spec that come only from the built-in profile `common`."""
    origins: Mapping[str, str] = field(default_factory=dict)
    """Option -> what declares it."""
    description: str = ""
    labels: Mapping[str, str] = field(default_factory=dict)
    where: Where = Where("")

    @property
    def options(self) -> Spec:
        """Its spec, empty if it has no container here."""
        return self.spec or {}

    @property
    def container_name(self) -> str:
        return str(self.options.get("container_name", self.name))

    def restarts_after(self, exit_code: int | None) -> bool:
        """Whether a run follows one that ended with this exit code."""
        return self.restart == "always" or (self.restart == "on-failure" and exit_code != 0)

    @property
    def calls(self) -> bool:
        """Whether it has a socket of rorg."""
        return bool(self.may_request or self.may_manage or self.may_act_for or self.may_report_graph)

    def manages(self, name: str) -> bool:
        return any(fnmatchcase(name, pattern) for pattern in self.may_manage)


@dataclass(frozen=True, slots=True)
class Group:
    """A name for several services."""

    name: str
    services: tuple[str, ...]
    """Names of services; groups inside are already replaced by their members."""
    description: str = ""
    where: Where = Where("")


@dataclass(frozen=True, slots=True)
class Image:
    """How an image is built, or imported."""

    name: str
    context: str | None
    """Absolute directory of the build, or None."""
    dockerfile: str
    args: Mapping[str, str]
    import_command: tuple[str, ...] | None
    directory: str
    """Working directory of the import command."""
    where: Where = Where("")
    target: str = ""
    """The stage that is built; empty for the last one."""
    platform: str = ""
    """os/architecture; empty for the engine's own."""
    bases: tuple[str, ...] = ()
    """References of all images that its Dockerfile uses, with build arguments filled in: each FROM, COPY --from and RUN
    --mount=from that does not name one of its own stages."""
    stand_ins: Mapping[str, str] = field(default_factory=dict)
    """Reference in its Dockerfile -> its replacement by `additional_contexts`, which is in `bases`."""
    cache_from: tuple[str, ...] = ()
    """References of images whose layers may be used; they are not part of its identity."""
    inline: str = ""
    """Its Dockerfile, if that is not a file. Then `dockerfile` only selects the .dockerignore."""
    secrets: tuple[str, ...] = ()
    """Build arguments with secret values."""
    reference: str = ""
    """The reference that services use: that of its content, once it is known."""


@dataclass(frozen=True, slots=True)
class Request:
    """A requester uses services."""

    id: str
    requester: str
    services: tuple[str, ...]
    """As written: names of services or groups."""
    reason: str = ""
    incarnation: str | None = None
    """The incarnation of the requester that sent it; None for meta-services, standing requests, and requests not yet
    bound."""
    standing: bool = False
    """Declared in a manifest, so it applies to every incarnation of its requester."""
    priority: int | None = None
    """Used under pressure and for exclusive resources; None means the priority of the services themselves."""
    ttl: float | None = None
    """Lease: seconds until it is dropped unless renewed; None for no end."""
    renewed: str = ""
    """Changes with every renewal, for requests that are renewed through the file."""
    where: Where = Where("")

    @property
    def key(self) -> tuple[str, str]:
        return (self.requester, self.id)


@dataclass(frozen=True, slots=True)
class Hold:
    """A person's order that a service must not be active until a time (seconds since the epoch)."""

    until: float
    reason: str = ""
    duration: float | None = None
    """Seconds that it lasts; None if a person wrote only `until`."""
    uptime: float = 0.0
    """When it ends, by the machine's monotonic clock in the boot `boot`. This counts, because the clock may be set."""
    boot: str = ""


@dataclass(frozen=True, slots=True)
class Catalog:
    """A whole tree."""

    services: Mapping[str, Service] = field(default_factory=dict)
    groups: Mapping[str, Group] = field(default_factory=dict)
    images: Mapping[str, Image] = field(default_factory=dict)
    networks: Mapping[str, EngineObject] = field(default_factory=dict)
    """By the name that services write."""
    volumes: Mapping[str, EngineObject] = field(default_factory=dict)
    """By the name that services write."""
    requests: tuple[Request, ...] = ()
    policy: Policy = Policy()
    machines: Mapping[str, Machine] = field(default_factory=dict)
    fingerprint: str = ""
    """Digest of the tree's content: equal digests declare the same."""

    def members(self, name: str) -> tuple[str, ...]:
        """The services of a name: itself, a group's members, or nothing if the name is unknown."""
        if name in self.services:
            return (name,)
        return self.groups[name].services if name in self.groups else ()


EMPTY = Catalog(services={DEVELOPER: Service(DEVELOPER, meta=True)})
