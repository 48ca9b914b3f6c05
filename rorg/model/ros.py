"""What services declare of ROS 1, and how ROS 2 programs are recognized: by environment, image and command."""

from __future__ import annotations

import re
from collections.abc import Collection, Container, Mapping
from dataclasses import dataclass, field
from typing import Any

MASTERS = ("roscore", "rosmaster")
PROGRAMS = frozenset((*MASTERS, "roslaunch", "rosrun", "rosbag", "rostopic", "rosnode", "rosservice", "rosparam"))
"""Programs that only ROS 1 has."""


@dataclass(frozen=True, slots=True)
class RosParameters:
    """Parameters for the ROS master, set before the service starts."""

    master: str
    """URI of the master; empty for a ROS 2 program, which has none."""
    values: Mapping[str, Any] = field(default_factory=dict)
    """By absolute name, in plain JSON that XML-RPC can carry."""


VARIABLES = (
    "ROS_DOMAIN_ID",
    "RMW_IMPLEMENTATION",
    "ROS_LOCALHOST_ONLY",
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_DISCOVERY_SERVER",
)
"""Any of these variables identifies a ROS 2 program."""
RELEASES = re.compile(r"(?<![a-z])(foxy|galactic|humble|iron|jazzy|kilted|rolling)(?![a-z])")
OFFICIAL = re.compile(r"(?:^|/)ros:")
"""Images whose tags are releases."""


def declares_ros2(environment: Container[str]) -> bool:
    """Whether the names of variables show a ROS 2 program."""
    return any(name in environment for name in VARIABLES)


def without_master(environment: Mapping[str, object], image: str, programs: Collection[str]) -> bool:
    """Whether a program is known to use ROS 2, and nothing shows that it also uses a ROS 1 master, as a bridge does."""
    if environment.get("ROS_MASTER_URI") or not PROGRAMS.isdisjoint(programs):
        return False
    release = str(environment.get("ROS_DISTRO") or (image if OFFICIAL.search(image) else ""))
    return declares_ros2(environment) or "ros2" in programs or RELEASES.search(release) is not None
