"""Facts about the machine that a robot will run on, gathered once (host/machine.py, engines/facts.py)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rorg.model.devices import Device, Plugged

ABSENT, DEVICE, FILE, DIRECTORY, SOCKET = "absent", "device", "file", "directory", "socket"


@dataclass(frozen=True, slots=True)
class Node:
    """The file at a path."""

    kind: str
    """absent, device, file, directory or socket."""
    mode: int = 0
    """Permissions, as of chmod."""
    uid: int = 0
    gid: int = 0
    group: str = ""
    """The name of `gid` here."""
    near: str = ""
    """For an absent path: the existing path that was most likely meant."""


@dataclass(frozen=True, slots=True)
class Machine:
    """The facts that were asked for."""

    nodes: Mapping[str, Node] = field(default_factory=dict)
    """By path."""
    plugged: Mapping[Device, Plugged] = field(default_factory=dict)
    """State of devices that drivers identify by attributes."""
    ports: Mapping[int, str] = field(default_factory=dict)
    """TCP ports in use -> the program; without those of the engine itself."""
    sysctls: Mapping[str, int] = field(default_factory=dict)
    """Kernel settings that are numbers, by name."""
    cgroup: int = 2
    """Version of control groups."""
    cpus: int = 1
    memory: int = 0
    """Bytes."""
    shm: int | None = None
    """Free bytes in /dev/shm; None if unknown."""
    runtimes: frozenset[str] | None = None
    """Runtimes of the engine; None if it was not asked or does not answer."""
    lacking: Mapping[str, str] = field(default_factory=dict)
    """Option of a container -> what the engine does with it instead, and why."""
    pauses: bool = True
    """The engine can pause containers."""
