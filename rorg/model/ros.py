"""What services declare of ROS, and how ROS 2 programs are recognized: by environment, image and command.

A graph has a name: the URI of a ROS 1 master, or `domain 0` for a domain of ROS 2."""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Container, Mapping
from dataclasses import dataclass, field
from typing import Any

MASTERS = ("roscore", "rosmaster")
PROGRAMS = frozenset((*MASTERS, "roslaunch", "rosrun", "rosbag", "rostopic", "rosnode", "rosservice", "rosparam"))
"""Programs that only ROS 1 has."""


PARAMETER_FILE = "parameters.yaml"
"""Name of the file in which rorg hands the parameters of a service to its programs of ROS 2."""
_DOMAIN = "domain "


def graph_of_domain(domain: int) -> str:
    """The name of the graph of a ROS 2 domain."""
    return f"{_DOMAIN}{domain}"


def domain_of(graph: str) -> int | None:
    """The ROS 2 domain of a graph's name; None for a ROS 1 master."""
    return int(graph.removeprefix(_DOMAIN)) if graph.startswith(_DOMAIN) else None


@dataclass(frozen=True, slots=True)
class RosParameters:
    """Parameters that rorg sets: at a ROS 1 master before the service starts, or at running nodes of ROS 2."""

    graph: str
    """Name of the graph."""
    values: Mapping[str, Any] = field(default_factory=dict)
    """By absolute name, in plain JSON that XML-RPC can carry."""


def parameter_file(values: Mapping[str, Any]) -> str:
    """Parameters by absolute name, as the text of a file for `--params-file` of ROS 2."""
    nodes: dict[str, dict[str, dict[str, Any]]] = {}
    for name, value in sorted(values.items()):
        node, _, parameter = name.rpartition("/")
        nodes.setdefault(node, {"ros__parameters": {}})["ros__parameters"][parameter] = value
    return json.dumps(nodes, sort_keys=True, indent=1) + "\n"  # JSON is YAML


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
