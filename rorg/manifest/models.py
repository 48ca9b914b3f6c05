"""The kinds of manifest as pydantic models. Marks as in container.py; `none` costs a running container nothing."""

from __future__ import annotations

from signal import Signals
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, WithJsonSchema, model_validator

from rorg.manifest import option_checks as check
from rorg.manifest.container import ContainerOptions, recreate, unchanging
from rorg.manifest.option_forms import Device, Pairs, Strict, Text, Words
from rorg.manifest.policy import Idle, PolicySpec, Units
from rorg.manifest.probes import Interlock, Live, Ready
from rorg.manifest.scalars import Memory, Name

API_VERSION = "rorg/v1"
Priority = Annotated[int, Field(ge=0, le=100)]


class Metadata(Strict):
    """What a manifest is called."""

    name: Name
    description: str | None = None
    labels: Pairs = Field(default_factory=dict)


class Resources(Strict):
    """Expected use, for budgets and simulation. Limits are container options (cpus, mem_limit)."""

    cpu: Annotated[float, Field(strict=False, ge=0)] = unchanging(0.0, description="Expected CPU, in cores.")
    memory: Memory = unchanging(0, description="Expected memory.")


class Driver(Strict):
    """A service that talks to hardware. It gets these devices and nothing more; restarting it by hand asks first."""

    devices: list[Device] = Field(default_factory=list, json_schema_extra={"x-rorg-change": "recreate"})
    groups: list[Annotated[Text, check.GROUP]] | None = recreate(
        description="Extra groups inside the container, such as dialout or video."
    )
    realtime: bool = Field(
        default=False,
        json_schema_extra={"x-rorg-change": "recreate"},
        description="SYS_NICE, rtprio 99 and unlimited memlock.",
    )


class Need(Strict):
    """A service that must be active, and ready, before this one."""

    service: Name
    restart: bool = unchanging(
        False, description="Restart this service too, whenever that one was restarted or replaced. Default: no."
    )


def _need(value: object) -> object:
    return {"service": value} if isinstance(value, str) else value


def _on_change(value: object) -> object:
    if value in ("restart", "none"):
        return value
    word, _, name = value.partition(" ") if isinstance(value, str) else ("", "", "")
    known = {s.name for s in Signals}
    name = name.strip().upper()
    name = name if name.startswith("SIG") else f"SIG{name}"
    if word != "signal" or name not in known:
        raise ValueError("must be restart, none, or signal NAME, such as signal SIGHUP")
    return name


VARIABLE = r"^[A-Za-z_*?][A-Za-z0-9_*?]*$"


def _inherited(value: object) -> object:
    return ["*"] if value == "all" else value


Inherited = Annotated[
    list[Annotated[str, Field(pattern=VARIABLE)]],
    BeforeValidator(_inherited),
    WithJsonSchema(
        {"anyOf": [{"const": "all"}, {"type": "array", "items": {"type": "string", "pattern": VARIABLE}}]},
    ),
]
OnChange = Annotated[
    str,
    BeforeValidator(_on_change),
    WithJsonSchema({"type": "string", "pattern": "^(restart|none|signal [A-Za-z0-9+]+)$"}),
]
Needs = list[Annotated[Need, BeforeValidator(_need)]]


def _container_only(spec: ServiceSpec) -> list[str]:
    names = (
        "image",
        "command",
        "profile",
        "idle",
        "ready",
        "live",
        "interlock",
        "driver",
        "mounts",
        "container",
        "restart",
        "inherit_environment",
    )
    return [n for n in names if getattr(spec, n) is not None]


class ServiceSpec(Strict):
    """A service: what runs, what it needs, and when it may end."""

    type: Literal["container", "meta"] = unchanging("container", description="meta: no container, always active.")
    image: Annotated[str, Field(min_length=1), check.IMAGE] | None = recreate(
        description="An Image of this tree, or any reference that the engine knows."
    )
    command: Words | None = recreate()
    profile: Name | None = unchanging(
        description="A Profile: built in (plain, ros1, ros2) or of this tree. plain: nothing but what is declared here."
    )
    needs: Needs = Field(
        default_factory=list,
        json_schema_extra={"x-rorg-change": "none"},
        description="Services that must be active, and ready, before this one: NAME, or "
        "{service: NAME, restart: true}.",
    )
    always_on: bool = unchanging(False)
    conflicts: list[Name] = Field(default_factory=list, json_schema_extra={"x-rorg-change": "none"})
    idle: Idle | None = unchanging()
    ready: Ready | None = unchanging()
    live: Live | None = unchanging()
    protected: bool | None = unchanging(
        description="Never ceased because the machine is under pressure. Default: true for drivers, else false."
    )
    interlock: Interlock | None = unchanging()
    exclusive: Units = Field(
        default_factory=dict,
        json_schema_extra={"x-rorg-change": "none"},
        description="Resources of which the machine has few: [gpu], or {gpu: 1}. The Policy says "
        "how many there are; 1 where it does not.",
    )
    may_request: list[Name] = Field(
        default_factory=list,
        json_schema_extra={"x-rorg-change": "recreate"},
        description="Services and groups that this service may request by itself. Gives it rorg's socket.",
    )
    may_restart: list[Name] = Field(
        default_factory=list,
        json_schema_extra={"x-rorg-change": "none"},
        description="Services and groups that it may restart, beside requesting something.",
    )
    may_act_for: list[Name | Literal["*"]] = Field(
        default_factory=list,
        json_schema_extra={"x-rorg-change": "recreate"},
        description="Services and groups in whose name it may act, within what their manifests allow to them: for a "
        'bridge that they call. "*" is every service, but not `developer`. Gives it rorg\'s socket.',
    )
    may_manage: list[Annotated[str, Field(pattern=r"^[a-z0-9_.*?-]{1,64}$")]] = Field(
        default_factory=list,
        json_schema_extra={"x-rorg-change": "recreate"},
        description="Patterns of names, such as lab-*: services that it may create, change, remove, request and "
        "restart, within what it may itself. Gives it rorg's socket.",
    )
    restart: Literal["always", "on-failure", "never"] | None = unchanging(
        description="What to do when a wanted service exits. Default: always, with growing pauses."
    )
    on_change: OnChange = unchanging(
        "restart",
        description="What to do when files change that this service mounts from the tree, read only: "
        "restart, `signal NAME`, or none. Default: restart.",
    )
    priority: Priority = unchanging(50, description="Under pressure the lowest give way first. Default: 50.")
    resources: Resources = Field(default_factory=Resources, json_schema_extra={"x-rorg-change": "none"})
    driver: Driver | None = recreate()
    mounts: list[str] | None = recreate(
        description="Configuration of this tree inside the container, read only: ./dir:/path/in/container."
    )
    inherit_environment: Inherited | None = recreate(
        description="Variables that a process has of the environment of `rorg run`: names and patterns, such as "
        "[ROS_*, DISPLAY], or all. What `container` says wins. On the process engine; containers have none of it.",
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
    """A name for several services."""

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
    common: bool = Field(
        default=True,
        description="false: it stands on nothing; what the profile common gives to every container is left out.",
    )
    needs: Needs = Field(default_factory=list)
    idle: Idle | None = None
    ready: Ready | None = None
    live: Live | None = None
    restart: Literal["always", "on-failure", "never"] | None = None
    without_hardware: bool = Field(
        default=False,
        description="Each device of a driver is /dev/null and realtime limits are left out: for laptops and tests.",
    )
    container: ContainerOptions | None = None


class RequestSpec(Strict):
    """A standing request: it holds whenever its requester is active."""

    requester: Name = "developer"
    services: Annotated[list[Name], Field(min_length=1)]
    reason: str | None = None
    priority: Priority | None = Field(default=None, description="Default: that of the services it names.")


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
FOLDERS = {
    "services": "Service",
    "groups": "Group",
    "images": "Image",
    "profiles": "Profile",
    "policies": "Policy",
    "requests": "Request",
}

NOT_YET = {
    ("Service", "driver", "hotplug"): "hot-plugging",
}
"""Fields that are planned: refused by name rather than accepted and ignored."""
