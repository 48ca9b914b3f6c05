"""What services declare of ROS 1, and which programs are of ROS 2: their environment, image and command tell."""

from __future__ import annotations

import re
from collections.abc import Collection, Container, Mapping
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


VARIABLES = (
    "ROS_DOMAIN_ID",
    "RMW_IMPLEMENTATION",
    "ROS_LOCALHOST_ONLY",
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_DISCOVERY_SERVER",
)
"""Any of them says that a program is one of ROS 2."""
RELEASES = re.compile(r"(?<![a-z])(foxy|galactic|humble|iron|jazzy|kilted|rolling)(?![a-z])")
OFFICIAL = re.compile(r"(?:^|/)ros:")
"""Images whose tags are releases."""


def declares_ros2(environment: Container[str]) -> bool:
    """Whether an environment, by the names of its variables, is that of a ROS 2 program."""
    return any(name in environment for name in VARIABLES)


def without_master(environment: Mapping[str, object], image: str, programs: Collection[str]) -> bool:
    """Whether a program is known to be one of ROS 2, and nothing says that it uses a ROS 1 master too, as a bridge
    does."""
    if environment.get("ROS_MASTER_URI") or not PROGRAMS.isdisjoint(programs):
        return False
    release = str(environment.get("ROS_DISTRO") or (image if OFFICIAL.search(image) else ""))
    return declares_ros2(environment) or "ros2" in programs or RELEASES.search(release) is not None
