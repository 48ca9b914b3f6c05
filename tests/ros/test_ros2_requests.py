"""What rclpy nodes request outlives rorg's ROS 2 node and rorg itself, and ends with its caller."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from robots import RealRobot, write_tree
from ros2_programs import Hand, Ros2, read
from ros_requests import CYCLES, PAUSE, Rorg, held

pytestmark = pytest.mark.docker
SLEPT = 6.0
"""Seconds for which the sleeper is paused at least: more than tests/support/ros2_nodes/sleeper.py takes for a stall."""
CROWD = 8
"""Calls that wait at the same time: more than an executor has threads."""


@pytest.fixture
def hand(ros2: Ros2, tmp_path) -> Iterator[Hand]:
    found = Hand(ros2, tmp_path)
    yield found
    found.close()


@pytest.fixture
def robot(dockerd, ros2: Ros2, tmp_path) -> Iterator[RealRobot]:
    """A rorg that can be ended, as `robot.rorg`; its ROS 2 node; and callers."""
    found = RealRobot(tmp_path, "docker", dockerd.host)

    def caller(node: str, command: str, *may: str, **more: object) -> dict:
        more = {"needs": ["rorg_ros2"], "restart": "never", "may_request": [*may], **more}
        return ros2.service(f"python3 /nodes/{command}", tmp_path, labels={"ros_nodes": f"/{node}"}, **more)

    tree = {
        "camera": PAUSE,
        "lamp": PAUSE,
        "slow": {"ready": {"delay": "4s"}},
        "never": {"ready": {"delay": "600s"}},
        "rorg_ros2": ros2.node(tmp_path, may_request=["lamp"]),
        "tour": caller("cycles", f"cycles.py /told/cycles camera {CYCLES}", "camera"),
        "waiter": caller("waiter", "ask.py /told/waiter waiter lamp slow", "slow"),
        "sleeper": caller("sleeper", "sleeper.py /told/sleeper camera", "camera", **PAUSE),
        "crowd": caller("crowd", f"crowd.py /told/crowd {CROWD} never", "never"),
    }
    write_tree(found.tree, tree)
    found.rorg = Rorg(found)
    yield found
    print(found.engine.api().logs(found.container("sleeper").id).decode())
    found.rorg.end()
    print("\n".join(found.rorg.log.read_text().splitlines()[-60:]))
    found.close()


def call(hand: Hand, name: str, **fields: object) -> dict:
    said = hand.run("python3", "/nodes/hand.py", name, json.dumps(fields))
    return json.loads(said.splitlines()[-1])


def test_callers_get_through_the_end_of_the_node_and_of_rorg(robot, hand, tmp_path):
    robot.request("tour", id="run")
    robot.request("sleeper", id="sleep")
    robot.wait(lambda: (tmp_path / "cycles").exists(), 120 + CYCLES)
    assert read(tmp_path / "cycles") == [], "told ready and found otherwise"
    robot.wait(lambda: (tmp_path / "sleeper").exists())
    assert held(robot) == {"developer": ["tour", "sleeper"], "tour": ["camera"], "sleeper": ["camera"]}

    hand.run("python3", "/nodes/ask.py", "/told/laptop", "laptop", "lamp", detach=True)
    robot.wait(lambda: (tmp_path / "laptop").exists())
    assert read(tmp_path / "laptop") == [[True, "requested lamp"]]
    assert held(robot)["rorg_ros2"] == ["lamp"]
    hand.run("pkill", "-KILL", "-f", "ask.py")
    crowd(robot, tmp_path)
    robot.release("sleep")
    robot.wait(lambda: robot.states()["sleeper"] == "paused")
    paused = time.monotonic()
    restart_rorg(robot, tmp_path)
    robot.wait(lambda: time.monotonic() > paused + SLEPT)  # and less than 20 s, after which DDS gives it up
    robot.request("sleeper", id="sleep")
    robot.wait(lambda: "rorg_ros2" not in held(robot), 60)  # what the laptop held
    robot.wait(lambda: (tmp_path / "sleeper.again").exists(), 30)
    assert read(tmp_path / "sleeper.again") == [[True, "requested camera"]], "it slept too long to keep its name"
    by_hand(robot, hand)
    kill_node(robot)
    assert held(robot)["waiter"] == ["slow"]
    assert held(robot)["tour"] == held(robot)["sleeper"] == ["camera"]


def by_hand(robot: RealRobot, hand: Hand) -> None:
    assert call(hand, "request", id="x", services=["lamp"], wait=30.0)["lease"] == 60.0
    assert held(robot)["rorg_ros2"] == ["lamp"], "though its caller is gone"
    assert call(hand, "release", id="x")["message"] == "released", "by another call of the same hand"
    assert "rorg_ros2" not in held(robot)
    assert call(hand, "request", id="x", services=["lamp"], wait=30.0)["success"]


def crowd(robot: RealRobot, folder: Path) -> None:
    """Calls that wait hold up no others."""
    robot.request("crowd", id="crowd")
    robot.wait(lambda: (folder / "crowd").exists(), 60)
    seconds, answered = read(folder / "crowd")
    assert (seconds < 10, answered) == (True, 0)
    robot.release("crowd")


def restart_rorg(robot: RealRobot, folder: Path) -> None:
    """While a caller waits."""
    robot.request("waiter", id="wait")
    robot.wait(lambda: "slow" in robot.active(), 60)
    for kill in (True, False):
        robot.rorg.end(kill)
        robot.rorg.start()
        robot.wait(lambda: robot.client().service("slow")["wanted"])
    robot.wait(lambda: (folder / "waiter").exists(), 60)
    light, slow = read(folder / "waiter")
    assert slow == [True, "requested slow"]
    assert "waiter may request slow" in light[1]


def kill_node(robot: RealRobot) -> None:
    """Nothing that its callers use is touched until the next one serves them."""

    def runs() -> list:
        return [(c.service, c.incarnation, c.state) for c in robot.containers() if c.service in ("camera", "lamp")]

    robot.wait(lambda: {"camera", "lamp"} <= robot.active())
    before, asked, old = runs(), robot.requests(), robot.container("rorg_ros2").incarnation
    client = robot.client()
    robot.kill("rorg_ros2")

    def again() -> bool:
        assert runs() == before
        assert robot.requests() == asked
        found = client.service("rorg_ros2")
        return found["health"] == "Healthy" and found["incarnation"] not in ("", old)

    robot.wait(again, 60)
