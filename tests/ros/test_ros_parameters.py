"""ROS 1 parameters that services declare: set before they start, again when their master was restarted, and when they
are declared otherwise."""

from __future__ import annotations

from typing import Any

import pytest
from robots import RealRobot, VirtualRobot, write_tree
from ros_master import healthy, master, services

from rorg.core.changed_fields import manifest_changes
from rorg.core.desired import desire
from rorg.core.masking import Masker
from rorg.history.journal import Filter
from rorg.manifest.effective import effective
from rorg.manifest.load import load_or_raise
from rorg.model.codes import PARAMETERS
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


def told(robot: RealRobot) -> list[dict[str, Any]]:
    """What the journal has of parameters that were set."""
    return robot.loop.recorder.journal.select(Filter(kinds=frozenset({"parameters-set"})), 9)


def said(robot: RealRobot) -> list[str]:
    """What the node has found, start by start."""
    return robot.engine.api().logs(robot.container("talker").id).decode().splitlines()


@pytest.mark.docker
def test_parameters_are_there_before_each_start_and_after_each_restart_of_the_master(docker_robot, ros_image, master):
    tree = robot_with_parameters(docker_robot, ros_image, master)
    docker_robot.declare(tree)
    docker_robot.request("talker")
    docker_robot.wait(lambda: healthy(docker_robot, "talker"))
    docker_robot.wait(lambda: said(docker_robot) == ["freight"])
    for name, value in VALUES.items():
        assert parameter(master, name) == (URDF if name == "/robot_description" else value)

    first = docker_robot.run_of("talker")
    docker_robot.kill("roscore")
    docker_robot.wait(lambda: docker_robot.container("talker").incarnation != first, 120)
    docker_robot.wait(lambda: healthy(docker_robot, "talker"))
    docker_robot.wait(lambda: said(docker_robot) == ["freight", "freight"])
    assert parameter(master, "/move_base/max_vel") == 0.5


@pytest.mark.docker
def test_a_changed_value_is_set_without_a_restart_and_one_set_by_hand_stays(docker_robot, ros_image, master):
    tree = robot_with_parameters(docker_robot, ros_image, master)
    docker_robot.declare(tree)
    docker_robot.request("talker")
    docker_robot.wait(lambda: healthy(docker_robot, "talker"))
    run = docker_robot.run_of("talker")
    docker_robot.stop()
    ros_master.call(master, "setParam", "/test", "/move_base/max_vel", 0.75)
    docker_robot.start()
    docker_robot.wait(lambda: docker_robot.loop.running.memory.of("talker").parameters)
    assert parameter(master, "/move_base/max_vel") == 0.75, "a new rorg sets nothing again"

    changed = {"ros": {"parameters": {**VALUES, "/move_base/max_vel": 0.25}}}
    docker_robot.declare({**tree, "talker": {**tree["talker"], **changed}})
    docker_robot.wait(lambda: parameter(master, "/move_base/max_vel") == 0.25)
    (docker_robot.tree / "services/freight.urdf").write_text(URDF.replace("base", "base_link"))
    docker_robot.wait(lambda: "base_link" in parameter(master, "/robot_description"))
    docker_robot.settle()
    assert docker_robot.run_of("talker") == run
    docker_robot.wait(lambda: len(told(docker_robot)) == 3)
    assert told(docker_robot)[-1]["parameters"] == sorted(VALUES)

    ros_master.call(master, "setParam", "/test", "/move_base/max_vel", 0.75)
    docker_robot.kill("talker")
    docker_robot.wait(lambda: docker_robot.container("talker").incarnation != run)
    assert parameter(master, "/move_base/max_vel") == 0.25, "another start begins with what is declared"


@pytest.mark.docker
def test_a_service_waits_for_a_master_that_is_not_there_and_then_starts_by_itself(docker_robot, ros_image, master):
    tree = robot_with_parameters(docker_robot, ros_image, master)
    del tree["roscore"]["always_on"]
    tree["talker"]["profile"] = "common"  # which needs nothing
    docker_robot.declare(tree)
    docker_robot.request("talker", id="talker")
    docker_robot.wait(lambda: f"{master} does not answer" in docker_robot.waits("talker"))
    assert docker_robot.waits("talker").startswith("its ROS parameters are not set: ")
    assert [w["code"] for w in docker_robot.status()["plan"]["waitings"]] == [PARAMETERS]
    docker_robot.request("roscore", id="roscore")
    docker_robot.wait(lambda: healthy(docker_robot, "talker"))
    docker_robot.wait(lambda: said(docker_robot) == ["freight"])


def test_parameters_are_simulated_too(tmp_path):
    robot = VirtualRobot(tmp_path)
    nav = {"profile": "ros1", "ros": {"parameters": {"/move_base/max_vel": 0.5}}}
    robot.declare({"roscore": {"ready": {"tcp": 11311}}, "nav": nav})
    robot.request("nav")
    robot.wait(lambda: robot.active() == {"roscore", "nav"})
    first = robot.run_of("nav")
    robot.kill("roscore")
    robot.wait(lambda: robot.run_of("nav") != first and robot.active() == {"roscore", "nav"})
    robot.settle()


def test_values_may_be_secret(tmp_path):
    """A name that says so hides its value wherever it stands; what has changed is told by name alone."""
    parameters = {"/speech/api_key": "s3cr3t-word", "/speech/language": "english", "/db": {"password": ["hunter2000"]}}
    before = load_or_raise(write_tree(tmp_path, {"speech": {"ros": {"parameters": parameters}}}))
    found = {v.field: v.text for v in effective(tmp_path, "speech")}
    assert found["ros.parameters./speech/api_key"] == found["ros.parameters./db"] == "(not shown)"
    assert found["ros.parameters./speech/language"] == "english"
    masker = Masker()
    masker.learn(before)
    assert masker.text("s3cr3t-word, hunter2000, english") == "***, ***, english"
    parameters["/speech/language"] = "german"
    after = load_or_raise(write_tree(tmp_path, {"speech": {"ros": {"parameters": parameters}}}))
    (changed,) = manifest_changes(desire(before), desire(after))
    assert [str(c) for c in changed.changes] == ["ros.parameters./speech/language changed"]
    assert desire(before).digests == desire(after).digests, "no container changes for it"
