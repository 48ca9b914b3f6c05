"""Devices of this machine: the one that a driver means, and its current state."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Device:
    """A device of a driver, by a stable path or by its attributes."""

    text: str
    """Its entry in the container's `devices`: PATH[:TARGET[:PERMISSIONS]], or udev(...):TARGET[:PERMISSIONS]."""
    path: str = ""
    """Path on the machine; empty for a device that is identified by attributes."""
    udev: tuple[tuple[str, str], ...] = ()
    """Its (attribute, value) pairs, sorted: vendor, product, serial, subsystem."""

    @property
    def identity(self) -> str:
        """Identifies the device, independent of the port and of its name in the container."""
        return self.path or "udev(" + ",".join(f"{name}={value}" for name, value in self.udev) + ")"

    def __str__(self) -> str:
        return self.path or "a device with " + ", ".join(f"{name} {value}" for name, value in self.udev)


@dataclass(frozen=True, slots=True)
class Plugged:
    """The current state of a device."""

    node: str = ""
    """Path of its node, links resolved; empty if it cannot be used."""
    number: str = ""
    """Type and number of the node, such as "c 188:0"; empty for a directory of nodes."""
    problem: str = ""
    """Why it cannot be used, such as "is not there"."""

    def __str__(self) -> str:
        return f"{self.number} {self.node}".strip()
