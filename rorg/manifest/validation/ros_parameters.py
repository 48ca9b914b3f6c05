"""ROS 1 parameters that services declare."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations
from typing import Any

from rorg.manifest.validation.finding import Finding
from rorg.manifest.validation.robot import Robot
from rorg.manifest.validation.subject import Subject


def _twice(robot: Robot) -> Iterator[Finding]:
    """One master has one value for each name, whoever sets it."""
    for one, other in combinations([s for s in robot.subjects if s.service.ros], 2):
        if robot.apart(one, other) or _master(one) != _master(other):
            continue
        before, now = _values(one), _values(other)
        for name in now:
            rival = next((n for n in before if _within(n, name) and (n != name or before[n] != now[name])), "")
            if rival:
                what = "another value" if rival == name else f"its {rival}"
                message = f"'{other.name}' sets {name}, for which '{one.name}' has {what}"
                where = other.at("ros", "parameters", name)
                yield Finding("ros-parameter-twice", where, message, "declaring it in a service that both need")


def _master(subject: Subject) -> str:
    return subject.service.ros.master if subject.service.ros else ""


def _values(subject: Subject) -> dict[str, Any]:
    return dict(subject.service.ros.values) if subject.service.ros else {}


def _within(one: str, other: str) -> bool:
    """Whether one of two names is the other, or in its namespace."""
    return f"{one}/".startswith(f"{other}/") or f"{other}/".startswith(f"{one}/")


CHECKS = (_twice,)
