"""Real ROS 1: what pausing a service does to others, told before it happens; and what keeps it from happening."""

from __future__ import annotations

import commands
import pytest
from common import wait_for
from ros_master import NODES, healthy, master, services  # noqa: F401  (`master` is a fixture)

pytestmark = pytest.mark.docker
MORE = 20
"""Messages that a publisher has sent on: more than a connection holds."""
STILL = 5.0
"""Seconds in which a publisher of 50 messages a second does not send as many: it is blocked."""


def node(image: str, uri: str, command: str, *mounts: str, **more) -> dict:
    return {
        "image": image,
        "profile": "ros1",
        "command": f"python3 /nodes/{command}",
        "container": {"environment": {"ROS_MASTER_URI": uri}, "volumes": [f"{NODES}:/nodes:ro", *mounts]},
        **more,
    }


@pytest.fixture
def robot(docker_robot, ros_image, master, tmp_path):  # noqa: F811
    """A publisher, and a subscriber that is wanted now; what it is connected to is known."""
    count = docker_robot.count = tmp_path / "count"
    count.mkdir()
    docker_robot.with_server = True

    def begin(sender: dict, **idle) -> None:
        docker_robot.declare(
            {
                **services(ros_image, master),
                "sender": node(ros_image, master, "sender.py sender /scan /count/sent", f"{count}:/count", **sender),
                "listener": node(
                    ros_image,
                    master,
                    "listener.py listener /scan",
                    ready={"ros_node": "/listener"},
                    idle={"action": "pause", **idle},
                ),
            }
        )
        docker_robot.request("listener")
        docker_robot.wait(lambda: healthy(docker_robot, "roscore", "listener"), 60)
        docker_robot.wait(lambda: "/listener/clear" in (pausable(docker_robot) or {}).get("message", ""))

    docker_robot.begin = begin
    return docker_robot


def pausable(robot) -> dict | None:
    """The condition by which pausing the listener is told not to be safe."""
    view = robot.status()["services"]["listener"]
    return next((c for c in view["conditions"] if c["type"] == "Pausable"), None)


def sent(robot) -> int:
    file = robot.count / "sent"
    return int((file.exists() and file.read_text()) or 0)


def goes_on(robot) -> bool:
    before = sent(robot)
    try:
        wait_for(lambda: sent(robot) > before + MORE, STILL)
    except AssertionError:
        return False
    return True


def test_a_paused_subscriber_blocks_its_publisher_and_that_is_told(robot):
    robot.begin({"always_on": True})
    robot.wait(lambda: pausable(robot)["reason"] == "PublisherBlocks")
    told = pausable(robot)
    assert told["status"] == "False"
    assert "subscribes to /scan of sender" in told["message"]
    assert "provides /listener/clear: callers hang" in told["message"]
    assert "publishes /listener/map, usually only once" in told["message"]
    robot.wait(lambda: any("pausing listener is not safe: it subscribes to /scan" in line for line in robot.log()))
    assert robot.client().why("listener")[0]["cautions"] == [told["message"]]
    said = commands.rorg("why", "listener", "--state-dir", robot.state.path).stdout
    assert f"  caution: {told['message']}" in said.splitlines()
    robot.release()
    robot.wait(lambda: robot.states()["listener"] == "paused")
    robot.wait(lambda: not goes_on(robot), 60)
    robot.request("listener")
    robot.wait(lambda: goes_on(robot))
    assert sum("pausing listener is not safe: it subscribes" in line for line in robot.log()) == 1


def test_one_that_is_connected_is_stopped_and_its_publisher_goes_on(robot):
    robot.begin({"always_on": True}, connected="stop")
    assert pausable(robot)["reason"] == "CallersHang", "the master does not know who calls"
    robot.wait(lambda: goes_on(robot))
    robot.release()
    robot.wait(lambda: robot.states()["listener"] == "exited")
    robot.wait(lambda: stopped_instead(robot))
    for _ in range(3):
        assert goes_on(robot)


def test_one_that_is_not_connected_is_paused_until_somebody_is(robot):
    robot.begin({"idle": {"action": "remove"}}, connected="stop")
    robot.release()
    robot.wait(lambda: robot.states()["listener"] == "paused")
    robot.request("sender", id="sender")
    robot.wait(lambda: robot.states()["listener"] == "exited")
    robot.wait(lambda: stopped_instead(robot))
    robot.wait(lambda: goes_on(robot))


def test_a_node_that_another_service_takes_from_a_paused_one_is_told(docker_robot, ros_image, master):  # noqa: F811
    tree = services(ros_image, master, "first", "second")
    for name in ("first", "second"):
        tree[name] |= {"command": "python3 /nodes/talker.py camera", "ready": {"ros_node": "/camera"}}
    docker_robot.declare(tree)
    docker_robot.request("first", id="first")
    docker_robot.wait(lambda: healthy(docker_robot, "first"), 60)
    docker_robot.wait(lambda: "first" in owners(docker_robot))
    docker_robot.release("first")
    docker_robot.wait(lambda: docker_robot.states()["first"] == "paused")
    docker_robot.request("second", id="second")
    text = "the ROS node /camera of first is registered by second now"
    docker_robot.wait(lambda: any(text in line for line in docker_robot.log()), 60)
    docker_robot.wait(lambda: text in cautions(docker_robot, "first") and text in cautions(docker_robot, "second"))


def owners(robot) -> set[str]:
    """Services of which a node is known."""
    return {service for graph in robot.loop.ros.masters.graphs.values() for service in graph.nodes.values()}


def cautions(robot, service: str) -> list[str]:
    conditions = robot.status()["services"][service]["conditions"]
    return [c["message"] for c in conditions if c["type"] == "NodesUnique"]


def stopped_instead(robot) -> bool:
    return any("stop instead of pause: connected to sender by /scan" in line for line in robot.log())
