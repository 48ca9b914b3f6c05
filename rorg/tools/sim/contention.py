"""Divides the CPU of a machine among programs that together want more than it has."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Demand:
    """What a program wants of the CPU."""

    cores: float
    shares: float
    """Its weight against other programs: `cpu_shares` of its container."""


def granted(demands: Mapping[str, Demand], cores: float) -> dict[str, float]:
    """The cores that each program gets (weighted max-min fairness). None gets more than it wants. Those that want more
    divide the rest by their shares, so nothing is left over while a program wants more."""
    if sum([one.cores for one in demands.values()]) <= cores:
        return {name: one.cores for name, one in demands.items()}
    found, left, shares = dict[str, float](), cores, sum([one.shares for one in demands.values()])
    for name, one in sorted(demands.items(), key=lambda item: (item[1].cores / item[1].shares, item[0])):
        found[name] = min(one.cores, left * one.shares / shares)
        left -= found[name]
        shares -= one.shares
    return found


@dataclass(slots=True)
class Shortage:
    """How long and how much the CPU was short."""

    seconds: float = 0.0
    """Seconds in which programs wanted more than all cores."""
    core_seconds: float = 0.0
    """What they wanted and did not get."""

    def add(self, seconds: float, wanted: float, got: float) -> None:
        """For so many seconds, programs wanted and got these cores together."""
        if wanted > got:
            self.seconds += seconds
            self.core_seconds += (wanted - got) * seconds
