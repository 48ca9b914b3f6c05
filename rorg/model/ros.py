"""What services declare of ROS 1."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

MASTERS = ("roscore", "rosmaster")
PROGRAMS = frozenset((*MASTERS, "roslaunch", "rosrun", "rosbag", "rostopic", "rosnode", "rosservice", "rosparam"))
"""Of ROS 1 alone."""


@dataclass(frozen=True, slots=True)
class RosParameters:
    """What the master of a service is given before the service starts."""

    master: str
    """Its URI; empty for a program of ROS 2, which has none."""
    values: Mapping[str, Any] = field(default_factory=dict)
    """By absolute name, in plain JSON: what XML-RPC can carry."""
