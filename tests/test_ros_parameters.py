"""ROS 1 parameters that services declare: set before they start, again when their master was restarted, and when they
are declared otherwise."""

from __future__ import annotations

from typing import Any

import pytest
from robots import RealRobot
from test_ros import healthy, master, services

from rorg.probes import ros_master

__all__ = ["master"]
URDF = '<robot name="freight"><link name="base"/></robot>\n'
VALUES: dict[str, Any] = {
    "/robot_name": "freight",
    "/move_base/max_vel": 0.5,
    "/move_base/layers": ["static", {"name": "inflation", "radius": 2}],
    "/use_sim_time": False,
    "/robot_description": {"file": "./freight.urdf"},
}


def parameter(master: str, name: str) -> Any:
    """At the master; None where it has no such one."""
    try:
        return ros_master.call(master, "getParam", "/test", name)
    except LookupError:
        return None


def robot_with_parameters(robot: RealRobot, image: str, master: str) -> dict[str, dict]:
    """One node says what it finds of a parameter when it begins."""
    tree = services(image, master, "talker")
    tree["talker"] |= {
        "command": "python3 /nodes/parameter.py talker /robot_name",
        "ros": {"parameters": dict(VALUES)},
    }
    (robot.tree / "services").mkdir(parents=True, exist_ok=True)
    (robot.tree / "services/freight.urdf").write_text(URDF)
    return tree


def said(robot: RealRobot) -> list[str]:
    """What the node has found, start by start."""
    return robot.engine.api().logs(robot.container("talker").id).decode().splitlines()


@pytest.mark.docker
def test_parameters_are_there_before_each_start_and_after_each_restart_of_the_master(docker_robot, ros_image, master):
    tree = robot_with_parameters(docker_robot, ros_image, master)
    docker_robot.declare(tree)
    docker_robot.request("talker")
    docker_robot.wait(lambda: healthy(docker_robot, "talker"))
    assert said(docker_robot) == ["freight"]
    for name, value in VALUES.items():
        assert parameter(master, name) == (URDF if name == "/robot_description" else value)

    first = docker_robot.run_of("talker")
    docker_robot.kill("roscore")
    docker_robot.wait(lambda: docker_robot.container("talker").incarnation != first)
    docker_robot.wait(lambda: healthy(docker_robot, "talker"))
    assert said(docker_robot) == ["freight", "freight"], "there when it started again"
    assert parameter(master, "/move_base/max_vel") == 0.5
