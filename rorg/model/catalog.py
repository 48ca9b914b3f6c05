"""What a tree of manifests says, frozen: the one input of all decisions."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from typing import Any

from rorg.model.devices import Device
from rorg.model.diagnostics import Where
from rorg.model.objects import EngineObject
from rorg.model.policy import Policy
from rorg.model.ros import RosParameters
from rorg.model.units import LONGEST

DEVELOPER = "developer"
"""The built-in meta-service: a person. Always active, so its requests live until they are released."""

EVERY = "*"
"""In `may_act_for`: every service, except developer."""

RUN = "${rorg.run}"
"""Stands for the directory of rorg's sockets until it is known which rorg runs this tree."""

SHORTEST_SECRET = 6
"""Characters of a secret that is looked for in texts; a shorter one is part of any text."""

Spec = Mapping[str, Any]
"""A rendered container: `image`, `command` and options under Compose's names, in plain JSON values; only what is
declared. Exactly this is sent to the engine, and exactly this is digested."""


@dataclass(frozen=True, slots=True)
class Idle:
    """What becomes of a service that nobody wants."""

    action: str = "stop"
    """pause, stop or remove."""
    linger: float = 0.0
    """Seconds a service stays active after nobody wants it."""
    min_active: float = 0.0
    """Seconds it stays active after it was started or resumed."""
    escalate: tuple[float, str] | None = None
    """(seconds after it was ceased, stop or remove)."""
    reclaim: bool = False
    prewarm: float = 0.0
    """Probability from which it is made active before it is requested; 0 for never."""
    connected: str = "pause"
    """pause or stop: what is done instead of pausing it while its ROS 1 nodes are connected to those of others."""


@dataclass(frozen=True, slots=True)
class Updating:
    """How a change of a service comes into use."""

    when: str = "now"
    """now, or when_ceased: once it is next ceased or restarted."""
    bake: float = 2.0
    """Seconds for which it must stay well, once it is ready, before the container before is given up."""
    atomic: str = ""
    """The set of services with which it changes, or goes back; empty for none."""


@dataclass(frozen=True, slots=True)
class Probe:
    """A question to a service: `ready`, `live` or `interlock`."""

    kind: str
    """delay, completed, tcp, http, file, exec, log, engine, ros_node, ros_topic, ros_service or ros_parameters; all for
    several."""
    target: float | str | tuple[str, ...]
    timeout: float = 30.0
    """Seconds after which a service counts as late."""
    interval: float = 0.25
    """Seconds between two probes."""
    failures: int = 0
    """So many failures in a row count; 0 for a readiness that is not probed again."""
    master: str = ""
    """URI of the ROS 1 master, for ros_*."""
    parts: tuple[Probe, ...] = ()
    """Those that must all hold, where there are several; its interval is the shortest of theirs."""

    @property
    def questions(self) -> tuple[Probe, ...]:
        """What is asked, one by one: its parts, or itself."""
        return self.parts or (self,)

    @property
    def delay(self) -> float | None:
        """The seconds that are its whole answer, where it asks nobody; None of every other kind. A task does not become
        ready however long it runs: it is `completed` once it has ended."""
        if self.completed:
            return LONGEST
        return float(self.target) if self.kind == "delay" and not isinstance(self.target, tuple) else None

    @property
    def completed(self) -> bool:
        """Of a task, which others wait for until it has ended well."""
        return self.kind == "completed"

    def __str__(self) -> str:
        if self.parts:
            return " and ".join(map(str, self.parts))
        if self.completed:
            return self.kind
        target = " ".join(self.target) if isinstance(self.target, tuple) else self.target
        return f"{self.kind} {target}"


@dataclass(frozen=True, slots=True)
class Service:
    """One service, with all that profiles and the Policy add to its manifest."""

    name: str
    meta: bool = False
    always_on: bool = False
    needs: tuple[str, ...] = ()
    """Names of services; groups are already replaced by their members."""
    restarts_with: tuple[str, ...] = ()
    """Those of `needs` whose restart restarts this service."""
    joins: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    """Service, among `needs` -> options by which its container's namespaces or volumes are used (see joining.py)."""
    conflicts: tuple[str, ...] = ()
    exclusive: Mapping[str, int] = field(default_factory=dict)
    """Resource -> units."""
    may_request: tuple[str, ...] = ()
    """Services and groups that it may request through the API."""
    may_restart: tuple[str, ...] = ()
    """Those that it may restart."""
    may_act_for: tuple[str, ...] = ()
    """Those in whose name it may act, as a bridge does for its callers; `*` for every service but developer."""
    may_manage: tuple[str, ...] = ()
    """Patterns of names of those that it may create, change and remove."""
    idle: Idle = Idle()
    update: Updating = Updating()
    ready: Probe | None = None
    live: Probe | None = None
    interlock: Probe | None = None
    """What must allow it before a container of this service is touched; None where nothing must."""
    protected: bool = False
    restart: str = "always"
    """always, on-failure or never."""
    on_change: str = "restart"
    """What to do when files change that it mounts from the tree: restart, none, or the name of a signal."""
    priority: int = 50
    cpu: float = 0.0
    """Expected use, cores."""
    memory: int = 0
    """Expected use, bytes."""
    driver: bool = False
    devices: tuple[Device, ...] = ()
    """Those without which it does not run."""
    unplugged: str = "stop"
    """What becomes of it when one of them goes: stop or keep."""
    ros: RosParameters | None = None
    spec: Spec | None = None
    """None for a meta-service."""
    secrets: tuple[str, ...] = ()
    """Variables of its environment whose values are secret: declared as such, or from a file of variables."""
    defaults: tuple[str, ...] = ()
    """Options in the spec that nobody asked for: they come from the profile `common` that is built in."""
    origins: Mapping[str, str] = field(default_factory=dict)
    """Option -> what of the tree declares it."""
    description: str = ""
    labels: Mapping[str, str] = field(default_factory=dict)
    where: Where = Where("")

    @property
    def container_name(self) -> str:
        return str((self.spec or {}).get("container_name", self.name))

    @property
    def calls(self) -> bool:
        """It has a socket of rorg's."""
        return bool(self.may_request or self.may_manage or self.may_act_for)

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
    """Where the import command runs."""
    where: Where = Where("")
    target: str = ""
    """The stage that is built; empty for the last one."""
    platform: str = ""
    """os/architecture; empty for the engine's own."""
    bases: tuple[str, ...] = ()
    """References of all images that its Dockerfile uses, build arguments filled in: each FROM, COPY --from and
    RUN --mount=from that names no stage of its own."""
    stand_ins: Mapping[str, str] = field(default_factory=dict)
    """Reference in its Dockerfile -> what stands for it by `additional_contexts`: that is in `bases`."""
    cache_from: tuple[str, ...] = ()
    """References of images whose layers may be used: no part of what it is."""
    inline: str = ""
    """Its Dockerfile, where that is no file: then `dockerfile` only says which .dockerignore counts."""
    secrets: tuple[str, ...] = ()
    """Arguments whose values are secret."""
    reference: str = ""
    """What services are made from: that of its content, once that is known."""


@dataclass(frozen=True, slots=True)
class Request:
    """That a requester uses services."""

    id: str
    requester: str
    services: tuple[str, ...]
    """As written: names of services or groups."""
    reason: str = ""
    incarnation: str | None = None
    """The run of the requester that sent it; None for meta-services, standing requests, and not yet bound ones."""
    standing: bool = False
    """Declared in a manifest, so it holds for every incarnation of its requester."""
    priority: int | None = None
    """Under pressure and for exclusive resources; None for that of the services themselves."""
    ttl: float | None = None
    """Lease: seconds until it is dropped unless it is renewed; None for no end."""
    renewed: str = ""
    """Changes with every renewal, for a request that is renewed by way of the file."""
    where: Where = Where("")

    @property
    def key(self) -> tuple[str, str]:
        return (self.requester, self.id)


@dataclass(frozen=True, slots=True)
class Hold:
    """A person's word that a service must not be active, until a time (seconds since the epoch)."""

    until: float
    reason: str = ""


@dataclass(frozen=True, slots=True)
class Catalog:
    """A whole tree."""

    services: Mapping[str, Service] = field(default_factory=dict)
    groups: Mapping[str, Group] = field(default_factory=dict)
    images: Mapping[str, Image] = field(default_factory=dict)
    networks: Mapping[str, EngineObject] = field(default_factory=dict)
    """By the name that services write."""
    volumes: Mapping[str, EngineObject] = field(default_factory=dict)
    """Likewise."""
    requests: tuple[Request, ...] = ()
    policy: Policy = Policy()
    fingerprint: str = ""
    """Identity of the tree's content: two equal ones declare the same."""

    def members(self, name: str) -> tuple[str, ...]:
        """The services a name stands for: itself, a group's members, or nothing where the name is unknown."""
        if name in self.services:
            return (name,)
        return self.groups[name].services if name in self.groups else ()


EMPTY = Catalog(services={DEVELOPER: Service(DEVELOPER, meta=True)})
