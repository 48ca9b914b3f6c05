"""The kinds of manifest as pydantic models. Marks as in container.py; `none` costs a running container nothing."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, WithJsonSchema, model_validator

from rorg.manifest.container import ContainerOptions, Device, Pairs, Strict, Texts, Words, recreate, unchanging
from rorg.manifest.scalars import Duration, Memory, Name

API_VERSION = "rorg/v1"


class Metadata(Strict):
    name: Name
    description: str | None = None
    labels: Pairs = Field(default_factory=dict)


class Idle(Strict):
    """What becomes of a service that nobody wants any more."""

    action: Literal["pause", "stop", "remove"] | None = unchanging(description="Default: stop.")
    linger: Duration | None = unchanging(description="How long it stays active after that. Default: 0.")


def _port(value: object) -> str:
    port = str(value).rpartition(":")[2]
    if isinstance(value, bool) or not port.isdigit() or not 0 < int(port) < 65536:
        raise ValueError("must be PORT or HOST:PORT, with a port from 1 to 65535")
    return str(value)


def _url(value: str) -> str:
    if not value.startswith("http://"):
        raise ValueError("must be a URL that begins with http://")
    return value


Port = Annotated[str, BeforeValidator(_port), WithJsonSchema({"type": ["integer", "string"]})]
Url = Annotated[str, AfterValidator(_url)]


class Ready(Strict):
    """When a running service counts as ready; exactly one of the probes. Without one, running is ready."""

    delay: Duration | None = unchanging(description="Ready this long after it began to run.")
    tcp: Port | None = unchanging(description="Ready when PORT, or HOST:PORT, accepts a connection.")
    http: Url | None = unchanging(description="Ready when a GET of this http:// URL answers 2xx or 3xx.")
    timeout: Duration = unchanging(30.0, description="After this, the service counts as late. Default: 30s.")
    interval: Duration = unchanging(0.25, description="Time between two probes. Default: 250ms.")

    @model_validator(mode="after")
    def _one(self) -> Ready:
        probes = [name for name in ("delay", "tcp", "http") if getattr(self, name) is not None]
        if len(probes) != 1:
            raise ValueError("exactly one of delay, tcp, http must be given")
        return self


class Resources(Strict):
    """Expected use, for budgets and simulation. Limits are container options (cpus, mem_limit)."""

    cpu: Annotated[float, Field(strict=False, ge=0)] = unchanging(0.0, description="Expected CPU, in cores.")
    memory: Memory = unchanging(0, description="Expected memory.")


class Driver(Strict):
    """A service that talks to hardware. It gets these devices and nothing more; restarting it by hand asks first."""

    devices: list[Device] = Field(default_factory=list, json_schema_extra={"x-rorg-change": "recreate"})
    groups: Texts | None = recreate(description="Extra groups inside the container, such as dialout or video.")
    realtime: bool = Field(
        default=False,
        json_schema_extra={"x-rorg-change": "recreate"},
        description="SYS_NICE, rtprio 99 and unlimited memlock.",
    )


def _container_only(spec: ServiceSpec) -> list[str]:
    return [n for n in ("image", "command", "profile", "idle", "ready", "driver", "mounts", "container", "restart")
            if getattr(spec, n) is not None]


class ServiceSpec(Strict):
    type: Literal["container", "meta"] = unchanging("container", description="meta: no container, always active.")
    image: Annotated[str, Field(min_length=1)] | None = recreate(
        description="An Image of this tree, or any reference that the engine knows."
    )
    command: Words | None = recreate()
    profile: Name | None = unchanging(description="A Profile: built in (ros1, ros2) or of this tree.")
    needs: list[Name] = Field(default_factory=list, json_schema_extra={"x-rorg-change": "none"},
                              description="Services that must be active, and ready, before this one.")
    always_on: bool = unchanging(False)
    conflicts: list[Name] = Field(default_factory=list, json_schema_extra={"x-rorg-change": "none"})
    idle: Idle | None = unchanging()
    ready: Ready | None = unchanging()
    restart: Literal["always", "on-failure", "never"] | None = unchanging(
        description="What to do when a wanted service exits. Default: always, with growing pauses."
    )
    priority: Annotated[int, Field(ge=0, le=100)] = unchanging(50)
    resources: Resources = Field(default_factory=Resources, json_schema_extra={"x-rorg-change": "none"})
    driver: Driver | None = recreate()
    mounts: list[str] | None = recreate(
        description="Configuration of this tree inside the container, read only: ./dir:/path/in/container."
    )
    container: ContainerOptions | None = recreate()

    @model_validator(mode="after")
    def _type(self) -> ServiceSpec:
        if self.type == "meta":
            extra = _container_only(self)
            if extra:
                raise ValueError(f"a meta service has no container: drop {', '.join(extra)}")
        elif self.image is None:
            raise ValueError("'image' is missing")
        return self


class GroupSpec(Strict):
    services: Annotated[list[Name], Field(min_length=1)]


class ImageSpec(Strict):
    """How `rorg build` makes an image: from a Dockerfile, or from a root file system that a command writes."""

    context: str | None = Field(default=None, description="Directory of the build, relative to this file.")
    dockerfile: str = "Dockerfile"
    args: Pairs = Field(default_factory=dict)
    import_: Words | None = Field(
        default=None,
        alias="import",
        description="A command that writes a root file system as a tar stream; run in this file's directory.",
    )

    @model_validator(mode="after")
    def _one(self) -> ImageSpec:
        if (self.context is None) == (self.import_ is None):
            raise ValueError("exactly one of context, import must be given")
        return self


class ProfileSpec(Strict):
    """What several services share. `${service}`, `${resources.cpu}` and `${resources.memory}` are filled in."""

    extends: list[Name] = Field(default_factory=list)
    needs: list[Name] = Field(default_factory=list)
    idle: Idle | None = None
    ready: Ready | None = None
    restart: Literal["always", "on-failure", "never"] | None = None
    without_hardware: bool = Field(
        default=False,
        description="Each device of a driver is /dev/null and realtime limits are left out: for laptops and tests.",
    )
    container: ContainerOptions | None = None


class PolicySpec(Strict):
    """Settings of the loop, for the whole machine."""

    idle: Idle | None = Field(default=None, description="For services that do not say.")
    resync: Duration = Field(default=60.0, description="Time between two full lists of the engine. Default: 60s.")
    bulk_workers: Annotated[int, Field(ge=1, le=16)] = Field(
        default=2, description="Engine calls at once for work that no request waits for. Default: 2."
    )


class RequestSpec(Strict):
    """A standing request: it holds whenever its requester is active."""

    requester: Name = "developer"
    services: Annotated[list[Name], Field(min_length=1)]
    reason: str | None = None


class Manifest(Strict):
    """The envelope of every manifest."""

    apiVersion: Literal["rorg/v1"]
    kind: str
    metadata: Metadata
    spec: Any


SPECS: dict[str, type[Strict]] = {
    "Service": ServiceSpec,
    "Group": GroupSpec,
    "Image": ImageSpec,
    "Profile": ProfileSpec,
    "Policy": PolicySpec,
    "Request": RequestSpec,
}
FOLDERS = {"services": "Service", "groups": "Group", "images": "Image", "profiles": "Profile", "policies": "Policy",
           "requests": "Request"}

_SERVICE = {
    ("Service", "live"): "liveness probes",
    ("Service", "may_request"): "rights of services",
    ("Service", "exclusive"): "exclusive resources",
    ("Service", "ready", "exec"): "readiness by exec",
    ("Service", "ready", "file"): "readiness by file",
    ("Service", "ready", "log"): "readiness by log",
    ("Service", "ready", "engine"): "readiness by the engine's health check",
    ("Service", "ready", "ros_node"): "readiness by ros_node",
    ("Service", "ready", "ros_topic"): "readiness by ros_topic",
    ("Service", "ready", "ros_service"): "readiness by ros_service",
    ("Service", "ready", "failures"): "a number of failures",
    ("Service", "idle", "min_active"): "a least active time",
    ("Service", "idle", "escalate"): "escalation of idling",
    ("Service", "driver", "hotplug"): "hot-plugging",
}
NOT_YET = {
    **_SERVICE,
    **{("Profile", *path[1:]): what for path, what in _SERVICE.items() if path[1] in ("ready", "idle")},
    ("Request", "ttl"): "leases",
    ("Policy", "budget"): "budgets",
    ("Policy", "pressure"): "pressure",
}
"""Fields that are planned: refused by name rather than accepted and ignored."""
