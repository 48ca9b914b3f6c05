"""The ROS 2 package with real rclpy: its node in a container, and callers that come and go."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from common import free_port
from robots import RealRobot
from ros2_programs import Hand, Ros2, read

pytestmark = pytest.mark.docker
REQUEST_ID = """
from rclpy.impl.implementation_singleton import rclpy_implementation
print(dir(rclpy_implementation.rmw_request_id_t))
"""
CAMERA = "python3 /nodes/talker.py camera"


@pytest.fixture
def port() -> int:
    return free_port()


@pytest.fixture
def robot(dockerd, ros2: Ros2, port, tmp_path) -> Iterator[RealRobot]:
    """rorg's node, a camera, and services that call."""
    found = RealRobot(tmp_path, "docker", dockerd.host, with_server=True)

    def caller(command: str, **more: object) -> dict:
        once = {"needs": ["rorg_ros2"], "restart": "never", "may_request": ["camera"]}
        return ros2.service(f"python3 /nodes/{command}", tmp_path, **once, **more)

    node = ros2.node(tmp_path, may_act_for=["behaviour", "impostor"])
    node["command"] += f" --ros-args -p notifications:={port}"
    rights = {"may_restart": ["camera"], "may_manage": ["lab-*"]}
    tree = {
        "camera": ros2.service(CAMERA, tmp_path, ready={"log": "talks"}, labels={"ros_nodes": "/camera"}),
        "arm": {},
        "rorg_ros2": node,
        "behaviour": caller("behaviour.py /told/told", labels={"ros_nodes": "/behaviour"}, **rights),
        "impostor": caller("impostor.py /told/impostor /camera look camera", labels={"ros_nodes": "/impostor"}),
        "reader": caller("reader.py /told/notified", ready={"log": "listens"}),
    }
    target = {"name": "ros", "webhook": {"url": f"http://127.0.0.1:{port}/"}, "on": ["lost"]}
    found.declare(tree, policies={"robot": {"notify": [target]}})
    yield found
    found.close()


def test_a_call_keeps_its_client_although_its_node_seems_to_be_gone(ros2, tmp_path):
    """A reporter that has just begun sees a part of the graph."""
    hand = Hand(ros2, tmp_path)
    try:
        assert hand.run("python3", "/nodes/keeping.py").split("\n") == ["True", "[]", ""]
    finally:
        hand.close()


def test_rclpy_does_not_tell_a_server_who_calls(ros2, tmp_path):
    """If this fails, the node can check the names of callers: see SECURITY.md."""
    hand = Hand(ros2, tmp_path)
    try:
        code = (
            "from rclpy.impl.implementation_singleton import rclpy_implementation as i; print(dir(i.rmw_request_id_t))"
        )
        said = hand.run("python3", "-c", code)
    finally:
        hand.close()
    assert "sequence_number" in said
    assert "guid" not in said


def answer(robot: RealRobot, file: Path) -> dict:
    robot.wait(file.exists, 60)
    return read(file)


def test_requests_through_ros2_live_as_long_as_their_caller(robot, tmp_path):
    robot.request("reader", id="read")
    robot.wait(lambda: "reader" in robot.active())
    robot.wait(lambda: robot.client().service("reader")["health"] == "Healthy")
    robot.request("behaviour", id="run")
    told = answer(robot, tmp_path / "told")
    assert told["request"] == [True, "requested camera"], "a node's name stands for its service"
    assert told["query"] == [True, "camera", "Healthy"]
    assert told["forbidden"][0] is False
    assert "may request camera" in told["forbidden"][1]
    assert "ttl and wait must be numbers" in told["endless"][1]
    assert (told["second"][0], told["release"]) == (True, [True, "released"])
    assert told["release_again"] == [True, "nothing to release"]
    assert told["restart"][0] is True
    assert "may restart camera" in told["restart_arm"][1]
    assert {"camera", "arm"} <= set(told["status"])
    assert told["put"] == [True, "written to services/lab-radio.yaml"]
    assert "may manage lab-*" in told["put_other"][1]
    assert told["get"] == [True, True]
    assert "changed meanwhile" in told["put_stale"][1]
    assert (told["put_again"][0], told["remove"][0]) == (True, True)
    assert "changed meanwhile" in told["remove_stale"][1]
    assert told["get_removed"][0] is False
    assert {r.requester for r in robot.requests()} == {"developer", "behaviour"}
    before = [r for r in robot.requests() if r.requester == "behaviour"]
    robot.wait(lambda: robot.client().service("camera")["health"] == "Healthy")  # it was restarted
    robot.request("impostor", id="steal")
    for done, message in answer(robot, tmp_path / "impostor").values():
        assert done is False
        # The node refuses it by the graph, or rorg does if the node has not seen all of the graph yet.
        assert re.match(
            "cannot (call as /camera: no node of this name has a client of /rorg/|[a-z]+ as camera:)", message
        )
    assert [r for r in robot.requests() if r.requester == "behaviour"] == before
    robot.kill("behaviour")
    robot.wait(lambda: {r.requester for r in robot.requests()} == {"developer"}, 5)
    notified = answer(robot, tmp_path / "notified")
    assert (notified["kind"], notified["service"], notified["cause"]) == ("lost", "camera", "restarted")
