"""The ROS 1 package with a real roscore: its node in a container, and callers that come and go."""

from __future__ import annotations

import json

from common import ROOT, free_port
from robots import RealRobot
from ros_master import NODES, services

READER = """
import pathlib, rospy
from std_msgs.msg import String
rospy.init_node("reader")
text = rospy.wait_for_message("/rorg/notifications", String).data
pathlib.Path("/told/notified.new").write_text(text)
pathlib.Path("/told/notified.new").rename("/told/notified")
"""
PACKAGE = ROOT / "clients/ros1/rorg_ros"


def test_requests_through_ros_live_as_long_as_their_caller(dockerd, ros_image, package, tmp_path):
    master, port = f"http://localhost:{free_port()}", free_port()
    robot = RealRobot(tmp_path, "docker", dockerd.host, with_server=True)
    tree = services(ros_image, master, "camera", "arm")
    ros = {
        "image": ros_image,
        "profile": "ros1",
        "container": {
            "environment": {"ROS_MASTER_URI": master, "PYTHONPATH": "/bridge/lib/python3/dist-packages:/program"},
            "volumes": [
                f"{package}:/bridge:ro",
                f"{ROOT / 'clients/python/rorg_client'}:/program/rorg_client:ro",
                f"{NODES}:/nodes:ro",
                f"{tmp_path}:/told",
            ],
        },
    }
    tree["rorg_ros"] = {
        **ros,
        "command": f"/bridge/lib/rorg_ros/rorg_node.py _notifications:={port}",
        "ready": {"ros_node": "/rorg"},
        "may_act_for": ["behaviour", "cpp", "impostor"],
    }
    tree["behaviour"] = {
        **ros,
        "command": "python3 /nodes/behaviour.py /told/told",
        "needs": ["rorg_ros"],
        "restart": "never",
        "may_request": ["camera"],
        "may_restart": ["camera"],
    }
    tree["impostor"] = {
        **ros,
        "command": "python3 /nodes/impostor.py /told/impostor /behaviour look camera",
        "needs": ["rorg_ros"],
        "restart": "never",
        "may_request": ["camera"],
    }
    tree["cpp"] = {
        **ros,
        "command": "/bridge/caller /camera",
        "needs": ["rorg_ros"],
        "restart": "never",
        "may_request": ["camera"],
    }
    tree["reader"] = {
        **ros,
        "command": ["python3", "-c", READER],
        "needs": ["rorg_ros"],
        "ready": {"ros_node": "/reader"},
        "restart": "never",
    }
    target = {"name": "ros", "webhook": {"url": f"http://127.0.0.1:{port}/"}, "on": ["lost"]}
    try:
        robot.declare(tree, policies={"robot": {"notify": [target]}})
        robot.request("reader", id="read")
        robot.request("behaviour", id="run")
        robot.wait(lambda: (tmp_path / "told").exists(), 60)
        told = json.loads((tmp_path / "told").read_text())
        assert told["request"] == [True, "requested camera"], "a node's name stands for its service"
        assert told["query"] == [True, "camera", "Healthy"]
        assert told["forbidden"][0] is False
        assert "may request camera" in told["forbidden"][1]
        assert told["restart"][0] is True
        assert "may restart camera" in told["restart_arm"][1]
        assert "camera" in told["status"]
        assert {r.requester for r in robot.requests()} == {"developer", "behaviour"}
        before = [r for r in robot.requests() if r.requester == "behaviour"]
        robot.request("impostor", id="steal")
        robot.wait(lambda: (tmp_path / "impostor").exists(), 60)
        for done, message in json.loads((tmp_path / "impostor").read_text()).values():
            assert done is False
            assert "cannot call as /behaviour: it is a process of behaviour, and impostor calls" in message
        assert [r for r in robot.requests() if r.requester == "behaviour"] == before
        robot.release("steal")
        robot.kill("behaviour")
        robot.wait(lambda: {r.requester for r in robot.requests()} == {"developer"}, 5)
        robot.wait(lambda: (tmp_path / "notified").exists(), 30)
        told = json.loads((tmp_path / "notified").read_text())
        assert (told["kind"], told["service"], told["cause"]) == ("lost", "camera", "restarted")
        robot.request("cpp", id="run")
        robot.wait(
            lambda: (
                ("cpp", "ros1:caller:cpp", ("camera",)) in [(r.requester, r.id, r.services) for r in robot.requests()]
            ),
            60,
        )
        robot.kill("cpp")
        robot.wait(lambda: {r.requester for r in robot.requests()} == {"developer"}, 5)
    finally:
        robot.close()
