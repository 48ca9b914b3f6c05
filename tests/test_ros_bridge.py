"""The ROS 1 package with a real roscore: its node in a container, and callers that come and go."""

from __future__ import annotations

import json
import re
import sys

from conftest import ROOT, free_port
from robots import RealRobot
from test_ros import NODES, services

PACKAGE = ROOT / "clients/ros1/rorg_ros"


def test_requests_through_ros_live_as_long_as_their_caller(dockerd, ros_image, package, tmp_path):
    master = f"http://localhost:{free_port()}"
    robot = RealRobot(tmp_path, "docker", dockerd.host, with_door=True)
    tree = services(ros_image, master, "camera", "arm")
    ros = {"image": ros_image, "profile": "ros1", "container": {
        "environment": {"ROS_MASTER_URI": master, "PYTHONPATH": "/bridge/lib/python3/dist-packages:/program"},
        "volumes": [f"{package}:/bridge:ro", f"{ROOT / 'rorg'}:/program/rorg:ro",
                    f"{ROOT / 'clients/python/rorg_client'}:/program/rorg_client:ro", f"{NODES}:/nodes:ro",
                    f"{tmp_path}:/told"]}}
    tree["rorg_ros"] = {**ros, "command": "/bridge/lib/rorg_ros/rorg_node.py", "ready": {"ros_node": "/rorg"},
                        "may_request": ["camera"], "may_restart": ["camera"]}
    tree["behaviour"] = {**ros, "command": "python3 /nodes/behaviour.py /told/told", "needs": ["rorg_ros"],
                         "restart": "never"}
    tree["cpp"] = {**ros, "command": "/bridge/caller /camera", "needs": ["rorg_ros"], "restart": "never"}
    try:
        robot.declare(tree)
        robot.request("behaviour", id="run")
        robot.wait(lambda: (tmp_path / "told").exists(), 60)
        told = json.loads((tmp_path / "told").read_text())
        assert told["request"] == [True, "requested camera"], "a node's name stands for its service"
        assert told["query"] == [True, "camera", "Healthy"]
        assert told["forbidden"][0] is False and "may request camera" in told["forbidden"][1]
        assert told["restart"][0] is True and "may restart camera" in told["restart_arm"][1]
        assert "camera" in told["status"]
        assert {r.requester for r in robot.requests()} == {"developer", "rorg_ros"}
        robot.kill("behaviour")
        robot.wait(lambda: {r.requester for r in robot.requests()} == {"developer"}, 2.0)
        robot.request("cpp", id="run")
        robot.wait(lambda: any(r.id.startswith("caller.cpp.") and r.services == ("camera",)
                               for r in robot.requests()), 60)
        robot.kill("cpp")
        robot.wait(lambda: {r.requester for r in robot.requests()} == {"developer"}, 2.0)
    finally:
        robot.close()


def test_no_two_callers_share_a_request():
    """Its logic, which the ROS 2 node shares, without any ROS."""
    sys.path.insert(0, str(PACKAGE / "src"))
    from rorg_ros.bridge import request_id

    assert request_id("/tour/guide", "x y").startswith("tour.guide.x.y.")
    assert re.fullmatch("[0-9a-f]{8}", request_id("/", ""))
    assert len(request_id("/a" * 100, "b")) <= 64
    names = [("/a" * 100, "b"), ("/a" * 100, "c"), ("/a/b", "c"), ("/a", "b.c"), ("/a.b", "c")]
    assert len({request_id(*name) for name in names}) == len(names), "no two share a request"


class Held:
    """A request that somebody holds; `meanwhile` happens while it is looked at."""

    def __init__(self) -> None:
        self.released = False

    def release(self) -> None:
        self.released = True


def test_a_caller_that_came_back_keeps_what_it_asked_for_since():
    sys.path.insert(0, str(PACKAGE / "src"))
    from rorg_ros.bridge import Bridge

    old, new = Held(), Held()
    bridge = Bridge(None, lambda caller: False)

    def alive(caller: str) -> bool:
        bridge._held["/tour", "request"] = new
        return False

    bridge._held["/tour", "request"], bridge.alive = old, alive
    assert bridge.sweep() == ["/tour"]
    assert not new.released
    bridge.close()
    assert new.released
