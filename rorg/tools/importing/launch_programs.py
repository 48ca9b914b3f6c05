"""The programs that a ROS 2 launch file starts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rorg.model.diagnostics import Where
from rorg.tools.importing.launch_values import Parameters, Scope

Remaps = tuple[tuple[str, str], ...]


@dataclass(frozen=True, kw_only=True)
class Component:
    """A node that a container loads."""

    package: str
    plugin: str
    name: str = ""
    namespace: str = ""
    parameters: Parameters = ()
    remaps: Remaps = ()
    extra: tuple[tuple[str, str], ...] = ()
    """Arguments for the container, such as use_intra_process_comms."""


@dataclass(frozen=True, kw_only=True)
class Program:
    """Any program."""

    where: Where
    name: str = ""
    environment: Mapping[str, str] = field(default_factory=dict)
    directory: str = ""
    """Its working directory; empty for that of the image."""
    respawn: bool = False
    notes: tuple[str, ...] = ()
    """Settings that the import drops."""


@dataclass(frozen=True, kw_only=True)
class Node(Program):
    """A program that starts one node, or a container of nodes."""

    package: str
    executable: str
    namespace: str = ""
    """Absolute; empty for the one that the program chooses."""
    arguments: tuple[str, ...] = ()
    ros_arguments: tuple[str, ...] = ()
    parameters: Parameters = ()
    remaps: Remaps = ()
    prefix: str = ""
    """A command line to run it with, such as gdb."""
    components: tuple[Component, ...] = ()
    autostart: bool = False
    """Whether the launch file configures and activates this lifecycle node."""

    @property
    def full_name(self) -> str:
        return f"{self.namespace.rstrip('/')}/{self.name}"


@dataclass(frozen=True, kw_only=True)
class Process(Program):
    """A program that is not said to be a node."""

    words: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Launch(Program):
    """A launch file that runs as a whole, because only `ros2 launch` can read it."""

    file: str
    scope: Scope


def joined(namespace: str, name: str) -> str:
    """A namespace inside another, absolute; empty if both are."""
    if name.startswith("/"):
        return name.rstrip("/") or "/"
    if not name:
        return namespace
    return f"{namespace.rstrip('/')}/{name}".rstrip("/")
