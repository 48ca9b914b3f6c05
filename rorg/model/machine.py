"""What is known of the machine that a robot is to run on: facts, gathered once (host/machine.py, engines/facts.py)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rorg.model.devices import Device, Plugged

ABSENT, DEVICE, FILE, DIRECTORY, SOCKET = "absent", "device", "file", "directory", "socket"


@dataclass(frozen=True, slots=True)
class Node:
    """What is at a path."""

    kind: str
    """absent, device, file, directory or socket."""
    mode: int = 0
    """Permissions, as of chmod."""
    uid: int = 0
    gid: int = 0
    group: str = ""
    """The name of `gid` here."""
    near: str = ""
    """Of what is absent: a path that is there, and most likely meant."""


@dataclass(frozen=True, slots=True)
class Machine:
    """This machine, as far as it was asked about."""

    nodes: Mapping[str, Node] = field(default_factory=dict)
    """By path."""
    plugged: Mapping[Device, Plugged] = field(default_factory=dict)
    """Devices that drivers know by what these say of themselves."""
    ports: Mapping[int, str] = field(default_factory=dict)
    """TCP ports that somebody listens at -> the program; those of the engine itself are not among them."""
    sysctls: Mapping[str, int] = field(default_factory=dict)
    """Numbers of the kernel, by name."""
    cgroup: int = 2
    """Version of control groups."""
    cpus: int = 1
    memory: int = 0
    """Bytes."""
    shm: int | None = None
    """Bytes that are free in /dev/shm; None where that is not known."""
    runtimes: frozenset[str] | None = None
    """Of the engine; None where it was not asked, or does not answer."""
