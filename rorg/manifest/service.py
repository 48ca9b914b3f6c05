"""The kind Service as pydantic models. A change of a field marked `none` does not touch a running container."""

from __future__ import annotations

from signal import Signals
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, ValidationInfo, WithJsonSchema, model_validator

from rorg.manifest import option_checks as check
from rorg.manifest.container import ContainerOptions
from rorg.manifest.driver import Driver
from rorg.manifest.fields import TEXT, Written, recreate, unchanging
from rorg.manifest.option_forms import Memory, Name, Strict, Words, one_or_many
from rorg.manifest.policy import Idle, Units, Update
from rorg.manifest.probes import Interlock, Live, Ready
from rorg.manifest.ros import Ros
from rorg.model.catalog import HIGHEST_PRIORITY
from rorg.model.units import NAME

Priority = Annotated[int, Field(ge=0, le=HIGHEST_PRIORITY)]


class Resources(Strict):
    """Expected use, for budgets and simulation. Limits are container options (cpus, mem_limit)."""

    cpu: Annotated[float, Field(strict=False, ge=0), Written("number of cores")] = unchanging(
        "Expected CPU, in cores.", 0.6, 0.0
    )
    memory: Memory = unchanging("Expected memory.", "180Mi", 0)


class Need(Strict):
    """A service that must be active and ready before this one."""

    service: Name = unchanging("A service, or a group.", "roscore", ...)
    restart: bool = unchanging("Restart this service too whenever that one is restarted or replaced.", True, False)


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


CONSTRAINT = (
    r"^(node\.(id|hostname|role|ip|platform\.(os|arch)|labels\.[\w.-]+)|engine\.labels\.[\w.-]+)"
    r"\s*(==|!=)\s*[\w.:*/-]+$"
)
SECRET = r"^[A-Za-z_][A-Za-z0-9_.-]{0,254}$"
VARIABLE = r"^[A-Za-z_*?][A-Za-z0-9_*?]*$"

Inherited = Annotated[
    list[Annotated[str, Field(pattern=VARIABLE)]],
    BeforeValidator(lambda value: ["*"] if value == "all" else value),
    Written("all | list of names and patterns", {"const": "all"}),
]
OnChange = Annotated[
    str,
    BeforeValidator(_on_change),
    WithJsonSchema({"type": "string", "pattern": "^(restart|none|signal [A-Za-z0-9+]+)$"}),
    Written("restart | none | signal NAME"),
]
ProfileNames = Annotated[
    list[Name],
    BeforeValidator(one_or_many),
    Field(min_length=1),
    Written("name | list of name", {"type": "string", "pattern": NAME}),
]
OptionalDriver = Annotated[
    Driver | None,
    BeforeValidator(lambda value: ({} if value else None) if isinstance(value, bool) else value),
    Written("Driver | true | false", {"type": "boolean"}),
]
_NeedForm = BeforeValidator(lambda value: {"service": value} if isinstance(value, str) else value)
Needs = list[Annotated[Need, _NeedForm, Written("name | Need", TEXT)]]
Restart = Literal["always", "on-failure", "never"]


_OF_CONTAINERS = (
    *("image", "command", "profile", "idle", "update", "ready", "live", "interlock", "ros", "driver", "mounts"),
    *("container", "restart", "inherit_environment", "machine"),
)
"""Fields that a meta-service cannot have."""


class ServiceSpec(Strict):
    """A service: its program, what it needs, and when it may stop."""

    type: Literal["container", "meta"] = unchanging("meta: no container, always active.", "meta", "container")
    machine: Name | None = unchanging(
        "The Machine that it belongs to, if the robot has several computers. any: any node of a Docker Swarm; while "
        "its network is split, such a service may run twice.",
        "nora-base",
        unset="the default one",
    )
    placement: list[Annotated[str, Field(pattern=CONSTRAINT, max_length=200)]] = recreate(
        "Nodes of the Swarm that may run it, for `machine: any`: each must hold, as in "
        "`docker service create --constraint`.",
        ["node.labels.gpu == yes"],
        list,
    )
    image: Annotated[str, Field(min_length=1), check.IMAGE] | None = recreate(
        "An Image of this tree, or any reference that the engine knows. Required, except for type: meta.",
        "fetch-navigation",
    )
    command: Words | None = recreate(
        "The command line. A text is split into words like in a shell, but no shell runs it.",
        "roslaunch /root/navigation/fetch_nav.launch --wait",
        unset="the image's",
    )
    profile: ProfileNames | None = unchanging(
        "A Profile: built in (plain, ros1, ros2, realtime, gpu, x11) or of this tree. Several act as one that extends "
        "them in this order. plain: only what is declared here.",
        ["ros1", "realtime"],
        unset="common",
    )
    needs: Needs = unchanging(
        "Services that must be active and ready before this one: NAME, or {service: NAME, restart: true}.",
        ["localization", {"service": "roscore", "restart": True}],
        list,
    )
    always_on: bool = unchanging("Active as long as rorg runs, without a request.", True, False)
    conflicts: list[Name] = unchanging("Services that must not be active together with this one.", ["mapping"], list)
    idle: Idle | None = unchanging(
        "The action when it is no longer wanted.",
        {"action": "pause", "linger": "20s"},
        unset="stop immediately",
    )
    update: Update | None = unchanging(
        "How a change of it is rolled out.", {"bake": "1m", "atomic": "navigation"}, unset="the Policy's `updates`"
    )
    ready: Ready | None = unchanging(
        "When it counts as ready, once it runs.", {"ros_node": "/move_base", "timeout": "30s"}, unset="when it runs"
    )
    live: Live | None = unchanging(
        "Restarts it when it runs and no longer answers.",
        {"http": "http://localhost:8080/health", "interval": "10s"},
        unset="not probed",
    )
    protected: bool | None = unchanging(
        "Never stopped because the machine is under pressure.", True, unset="true for drivers, else false"
    )
    interlock: Interlock | None = unchanging(
        "A check that must allow it before its container is started, paused, stopped or removed.",
        {"file": "/run/robot/arm-is-parked"},
        unset="the Policy's for drivers and protected services, else none",
    )
    exclusive: Units = unchanging(
        "Resources that few services can use at a time: [gpu], or {gpu: 1}. The Policy sets how many exist; by "
        "default 1.",
        {"gpu": 1},
        dict,
    )
    may_request: list[Name] = recreate(
        "Services and groups that this service may request itself. Gives it rorg's socket.", ["driving"], list
    )
    may_restart: list[Name] = unchanging("Services and groups that it may restart.", ["usb_cam"], list)
    may_act_for: list[Name | Literal["*"]] = recreate(
        "Services and groups for which it may act, within their own permissions, as a bridge does for its "
        'callers. "*" is every service except `developer`. Gives it rorg\'s socket.',
        ["*"],
        list,
    )
    may_manage: list[Annotated[str, Field(pattern=r"^[A-Za-z0-9_.*?-]{1,64}$")]] = recreate(
        "Patterns of names, such as lab-*, of services that it may create, change, remove, request and restart, "
        "within its own permissions. Gives it rorg's socket.",
        ["lab-*"],
        list,
    )
    may_report_graph: bool = recreate(
        "It may report the graph of ROS 2, as the node of `clients/ros2` does. Gives it rorg's socket.", True, False
    )
    restart: Restart | None = unchanging(
        "When to restart it if it exits while it is wanted. Delays grow.", "on-failure", unset="always"
    )
    on_change: OnChange = unchanging(
        "The reaction to changed files that this service mounts from the tree, read only. For a signal, mount their "
        "directory: a change of a single mounted file restarts it.",
        "signal SIGHUP",
        "restart",
    )
    priority: Priority = unchanging("0 to 100. Under pressure the lowest give way first.", 80, 50)
    resources: Resources = unchanging(
        "Expected use, for budgets and simulation; the Swarm reserves it for `machine: any`. Limits are container "
        "options (cpus, mem_limit).",
        {"cpu": 0.6, "memory": "180Mi"},
        Resources,
    )
    ros: Ros | None = unchanging(
        "Settings of a ROS program: parameters, managed nodes, names.",
        {"parameters": {"/robot_name": "freight", "/move_base/max_vel": 0.5}},
    )
    driver: OptionalDriver = recreate(
        "Hardware that it talks to: it gets these devices and no others. `true` for a driver without devices.",
        {"devices": ["/dev/ttyUSB0:/dev/base"]},
    )
    mounts: list[str] | None = recreate(
        "Configuration of this tree inside the container, read only: ./dir:/path/in/container.",
        ["./navigation:/root/navigation"],
    )
    inherit_environment: Inherited | None = recreate(
        "Variables that a process inherits from the environment of `rorg run`: names and patterns, or all. Variables "
        "in `container` win. For the process engine only.",
        ["ROS_*", "DISPLAY"],
    )
    unset_environment: list[Annotated[str, Field(pattern=SECRET)]] = recreate(
        "Variables of its profile to remove.", ["ROS_HOSTNAME"], list
    )
    secrets: list[Annotated[str, Field(pattern=SECRET)]] = unchanging(
        "Names of variables, or of build arguments of its image, whose values rorg never shows or records. Variables "
        "from an env_file are always secret.",
        ["MAP_SERVER_KEY"],
        list,
    )
    container: ContainerOptions | None = recreate(
        "Options of the container, named as in Compose.", {"volumes": ["maps:/root/maps"], "mem_limit": "512Mi"}
    )

    @model_validator(mode="after")
    def _type(self, info: ValidationInfo) -> ServiceSpec:
        if info.context == check.PARTIAL:
            return self
        if self.type == "meta":
            extra = [name for name in _OF_CONTAINERS if getattr(self, name) is not None]
            if extra:
                raise ValueError(f"a meta service has no container: drop {', '.join(extra)}")
        elif self.image is None:
            raise ValueError("'image' is missing")
        return self
