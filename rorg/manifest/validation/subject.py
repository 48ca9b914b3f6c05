"""A service as checks see it: rendered, with the places of its values in the manifest."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

from rorg.manifest.documents import Source
from rorg.model.catalog import Service
from rorg.model.diagnostics import Where
from rorg.model.ports import Published, parse_ports
from rorg.model.probe import ROS_KINDS, Probe
from rorg.model.ros import MASTERS, PROGRAMS, declares_ros2, without_master
from rorg.model.volumes import Mount, mounted_at, read_mount

SHELLS = ("sh", "bash", "dash", "zsh", "ash")
ROS2_PROGRAMS = frozenset(("ros2",))
BEFORE = frozenset(("exec", "env", "nohup", "ros_entrypoint.sh", "tini", "--"))
"""Words in front of a program that becomes the same process."""
OPERATORS = frozenset((";", "&&", "||", "|", "&", "\n"))
MOST_SCRIPT = 128 << 10
"""Maximum number of characters that checks read of a shell's script."""


class Asked(NamedTuple):
    """One question of a probe."""

    role: str
    probe: Probe
    part: int | None
    """Index in the list `all`; None if it is the only question."""

    @property
    def path(self) -> tuple[str | int, ...]:
        """Its path in the spec."""
        return (self.role, self.probe.kind) if self.part is None else (self.role, "all", self.part, self.probe.kind)


@dataclass(frozen=True, eq=False)
class Subject:
    """One service that has a container."""

    service: Service
    source: Source
    top: str = ""
    """The directory of the tree, without links."""
    memo: dict[str, Any] = field(default_factory=dict)
    """Cache for texts.once."""

    @property
    def name(self) -> str:
        return self.service.name

    @cached_property
    def options(self) -> Mapping[str, Any]:
        return self.service.options

    @cached_property
    def env(self) -> Mapping[str, str]:
        return dict(self.options.get("environment", {}))

    @cached_property
    def words(self) -> tuple[str, ...]:
        """The command line, as far as the manifest declares it: entry point, then command."""
        return (*(self.options.get("entrypoint") or ()), *(self.options.get("command") or ()))

    @cached_property
    def script(self) -> str:
        """The script that a shell runs by `-c`, up to a maximum length; empty if there is none."""
        for first, second, text in zip(self.words, self.words[1:], self.words[2:], strict=False):
            if first.rpartition("/")[2] in SHELLS and re.fullmatch("-[a-z]*c", second):
                return text[:MOST_SCRIPT]
        return ""

    @cached_property
    def commands(self) -> tuple[tuple[str, ...], ...]:
        """The single commands: those of the script, or the command line without a shell."""
        return tuple(_commands(self.script)) if self.script else (self.words,)

    @cached_property
    def programs(self) -> frozenset[str]:
        """Names of programs, including all words that may be a program behind another (`entry.sh roslaunch`)."""
        return frozenset(word.rpartition("/")[2] for command in self.commands for word in command)

    @cached_property
    def executables(self) -> frozenset[str]:
        """Names of the programs that its commands start, including nodes behind `rosrun` and `ros2 run`."""
        return frozenset(name for command in self.commands if (name := _executable(command)))

    @cached_property
    def network(self) -> str:
        """host, none, bridge, the name of a network, container:NAME, or `networks`."""
        if self.options.get("network_disabled"):
            return "none"
        mode = str(self.options.get("network_mode") or "")
        return mode or ("networks" if self.options.get("networks") else "bridge")

    @property
    def ipc(self) -> str:
        return str(self.options.get("ipc") or "private")

    @property
    def uid(self) -> str:
        """The user of its processes, as written; 0 without a declaration, as in most images."""
        user = str(self.options.get("user") or "0").partition(":")[0]
        return "0" if user == "root" else user

    @cached_property
    def ros2(self) -> bool:
        return declares_ros2(self.env) or not ROS2_PROGRAMS.isdisjoint(self.programs)

    @cached_property
    def without_master(self) -> bool:
        """Whether it is a program of ROS 2 only."""
        return without_master(self.env, str(self.options.get("image") or ""), self.programs)

    @cached_property
    def ros1(self) -> bool:
        return (
            "ROS_MASTER_URI" in self.env
            or not PROGRAMS.isdisjoint(self.programs)
            or (self.service.domain is None and (self.service.ros is not None or any(self.graph_probes)))
        )

    @cached_property
    def asked(self) -> tuple[Asked, ...]:
        """The questions of its probes: those of `ready`, then those of `live`."""
        return (*_asked("ready", self.service.ready), *_asked("live", self.service.live))

    @property
    def graph_probes(self) -> tuple[Asked, ...]:
        """The questions of its probes about the ROS graph, as far as the manifest asks them."""
        return tuple(asked for asked in self.asked if asked.probe.kind in ROS_KINDS)

    @cached_property
    def asked_ready(self) -> tuple[Asked, ...]:
        """The questions of `ready`."""
        return tuple(asked for asked in self.asked if asked.role == "ready")

    @property
    def ros(self) -> bool:
        return self.ros1 or self.ros2

    @cached_property
    def is_master(self) -> bool:
        return not self.programs.isdisjoint(MASTERS)

    @cached_property
    def mounts(self) -> tuple[Mount, ...]:
        return tuple(map(read_mount, self.options.get("volumes") or ()))

    @cached_property
    def mounts_of_tree(self) -> tuple[Mount, ...]:
        """Mounts whose source is in the tree."""
        return tuple(m for m in self.mounts if m.path and (m.path == self.top or m.path.startswith(f"{self.top}/")))

    @cached_property
    def devices(self) -> tuple[tuple[str, str], ...]:
        """(path on the host, path in the container) of each device that is named by a path."""
        parts = (value.split(":") for value in self.options.get("devices") or ())
        return tuple((host, rest[0] if rest and rest[0] else host) for host, *rest in parts)

    @cached_property
    def published(self) -> tuple[tuple[int, Published], ...]:
        """(index in `ports`, port) of each port of this machine that it publishes."""
        ports = list[tuple[int, Published]]()
        for index, text in enumerate(self.options.get("ports") or ()):
            with suppress(ValueError):  # a mistake that the model of the container has reported
                ports += [(index, port) for port in parse_ports(text) if port.host.isdigit()]
        return tuple(ports)

    @property
    def pauses(self) -> bool:
        """Whether it may be paused when idle."""
        return self.service.idle.action == "pause" and not self.service.always_on

    @property
    def mindful(self) -> bool:
        """Whether it is never paused while its ROS nodes are connected to those of other services."""
        return self.service.idle.connected != "pause"

    # -- places ------------------------------------------------------------------------------------------------

    def at(self, *path: str | int) -> Where:
        """The place of a field of the spec, or of the profile that sets it."""
        values, known = self.source.document.values, path[: 2 if path[0] == "container" else 1]
        if ("spec", *known) in values:
            return self.source.where("spec", *path)
        profile = path[0] in ("container", "idle", "needs") and ("spec", "profile") in values
        return self.source.where("spec", "profile") if profile else self.source.where("metadata", "name")

    def option(self, name: str, *below: str | int) -> Where:
        """The place of an option of the container."""
        return self.at("container", name, *below)

    def variable(self, name: str) -> Where:
        """The place of a variable of its environment."""
        values, at = self.source.document.values, ("spec", "container", "environment", name)
        if place := self._first((at[1:3],), lambda item: str(item).partition("=")[0] == name):
            return place
        profile = at not in values and ("spec", "profile") in values
        return self.source.where("spec", "profile") if profile else self.option("environment", name)

    def volume(self, mount: Mount) -> Where:
        """The place of a volume, by its path in the container."""
        paths = (("container", "volumes"), ("mounts",))
        return self._first(paths, lambda item: _target(item) == mount.target) or self.option("volumes")

    def device(self, host: str) -> Where:
        """The place of a device, by its path on the host."""

        def same(item: Any) -> bool:
            return host == (item.partition(":")[0] if isinstance(item, str) else item.get("source", item.get("path")))

        return self._first((("driver", "devices"), ("container", "devices")), same) or self.option("devices")

    def group(self, name: str) -> Where:
        """The place of a group that is added."""
        paths = (("driver", "groups"), ("container", "group_add"))
        return self._first(paths, lambda item: str(item) == name) or self.option("group_add")

    def item(self, name: str, *values: str) -> Where:
        """The place of the first of these items in an option that is a list."""
        return self._first((("container", name),), lambda item: item in values) or self.option(name)

    def _first(self, paths: Iterable[tuple[str, ...]], wanted: Callable[[Any], bool]) -> Where | None:
        """The place of the first wanted item in the lists at these paths of the manifest's spec."""
        for path in paths:
            for index, item in enumerate(self.written_list(*path)):
                if wanted(item):
                    return self.source.where("spec", *path, index)
        return None

    def command(self) -> Where:
        own = ("spec", "command") in self.source.document.values
        return self.at("command") if own else self.option("entrypoint")

    def _written(self, *path: str) -> Any:
        value: Any = self.source.document.value["spec"]
        for part in path:
            value = value.get(part) if isinstance(value, dict) else None
        return value

    def written_list(self, *path: str) -> list[Any]:
        value = self._written(*path)
        return value if isinstance(value, list) else []


def _asked(role: str, probe: Probe | None) -> Iterator[Asked]:
    for index, one in enumerate(probe.questions if probe else ()):
        yield Asked(role, one, index if probe and probe.parts else None)


def _executable(command: tuple[str, ...]) -> str:
    names = [word.rpartition("/")[2] for word in command]
    for at, name in enumerate(names):
        if name == "rosrun":
            return next(iter(names[at + 2 :]), "")
        if name == "ros2":
            return next(iter(names[at + 3 :]), "") if names[at + 1 : at + 2] == ["run"] else ""
    return next((name for name in names if name not in BEFORE), "")


def _commands(text: str) -> Iterator[tuple[str, ...]]:
    lexer = shlex.shlex(text.replace("\n", " ; "), posix=True, punctuation_chars=";&|")
    lexer.whitespace_split, lexer.commenters = True, ""
    command: list[str] = []
    try:
        for word in lexer:
            if set(word) <= set(";&|"):
                yield tuple(command)
                command = []
            else:
                command.append(word)
    except ValueError:  # an unclosed quote: the shell will report it
        command += text.split()
    yield tuple(command)


def _target(item: object) -> str:
    try:
        return mounted_at(item)  # type: ignore[arg-type]
    except (AttributeError, KeyError, TypeError):
        return ""
