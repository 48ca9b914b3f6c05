"""Devices of this machine: which one a driver means, and what there is of it now."""

from __future__ import annotations

from dataclasses import dataclass

UNPLUGGED = ("stop", "keep")
"""What becomes of a driver whose device goes."""


@dataclass(frozen=True, slots=True)
class Device:
    """One that a driver is given, by a name that stays or by what it says of itself."""

    text: str
    """Its entry among the container's `devices`: PATH[:TARGET[:PERMISSIONS]], or udev(...):TARGET[:PERMISSIONS]."""
    path: str = ""
    """On the machine; empty for one that is known by its attributes."""
    udev: tuple[tuple[str, str], ...] = ()
    """(attribute, value) of it, sorted: vendor, product, serial, subsystem."""

    @property
    def identity(self) -> str:
        """The same for the same device, wherever it is plugged in and whatever it is called in the container."""
        return self.path or "udev(" + ",".join(f"{name}={value}" for name, value in self.udev) + ")"

    def __str__(self) -> str:
        return self.path or "a device with " + ", ".join(f"{name} {value}" for name, value in self.udev)


@dataclass(frozen=True, slots=True)
class Plugged:
    """What there is of a device now."""

    node: str = ""
    """Path of its node, links followed; empty where it cannot be used."""
    number: str = ""
    """Kind and number of the node, such as "c 188:0"; empty of a directory of nodes."""
    problem: str = ""
    """Why it cannot be used, such as "is not there"."""

    def __str__(self) -> str:
        return f"{self.number} {self.node}".strip()
