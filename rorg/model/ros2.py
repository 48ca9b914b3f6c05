"""Which programs are of ROS 2: their environment, their image and what they run tell it."""

from __future__ import annotations

import re
from collections.abc import Collection, Container, Mapping

from rorg.model.ros import PROGRAMS

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
