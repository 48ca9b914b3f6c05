"""ROS 2 as the environment of a program tells it."""

from __future__ import annotations

from collections.abc import Container

VARIABLES = (
    "ROS_DOMAIN_ID",
    "RMW_IMPLEMENTATION",
    "ROS_LOCALHOST_ONLY",
    "ROS_AUTOMATIC_DISCOVERY_RANGE",
    "ROS_DISCOVERY_SERVER",
)
"""Any of them says that a program is one of ROS 2."""


def declares_ros2(environment: Container[str]) -> bool:
    """Whether an environment, by the names of its variables, is that of a ROS 2 program."""
    return any(name in environment for name in VARIABLES)
