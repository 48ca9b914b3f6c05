"""A ROS 1 master, and services with nodes."""

from __future__ import annotations

import pytest
from common import SUPPORT, free_port

NODES = SUPPORT / "ros_nodes"


@pytest.fixture
def master() -> str:
    return f"http://localhost:{free_port()}"


def services(image: str, master: str, *nodes: str) -> dict[str, dict]:
    """roscore and some talkers."""
    environment = {"ROS_MASTER_URI": master}
    found = {
        "roscore": {
            "image": image,
            "command": f"roscore -p {master.rpartition(':')[2]}",
            "always_on": True,
            "ready": {"ros_node": "/rosout"},
            "container": {"environment": environment},
        }
    }
    for name in nodes:
        found[name] = {
            "image": image,
            "profile": "ros1",
            "command": f"python3 /nodes/talker.py {name}",
            "ready": {"ros_node": f"/{name}"},
            "idle": {"action": "pause"},
            "container": {"environment": environment, "volumes": [f"{NODES}:/nodes:ro"]},
        }
    return found


def healthy(robot, *names: str) -> bool:
    views = robot.status().get("services", {})
    return all(views.get(n, {}).get("health") == "Healthy" for n in names)
