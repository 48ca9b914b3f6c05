"""How ROS 1 programs end under `profile: ros1`: at once, by themselves, and without a registration left behind."""

from __future__ import annotations

from pathlib import Path

import pytest
from common import run_in_container
from robots import RealRobot
from ros_master import NODES, healthy, master, services
from ros_stops import LONGEST, ROUNDS, stop_seconds

from rorg.probes import ros_master

pytestmark = pytest.mark.docker
__all__ = ["master"]
PROGRAMS = {
    "cpp": "/built/waiter cpp",
    "shell": "bash -c '/built/waiter shell; true'",
    "python": "python3 /nodes/talker.py python",
    "launched": "roslaunch --wait /nodes/waiter.launch name:=launched",
}


@pytest.fixture(scope="session")
def built(dockerd, ros_image, tmp_path_factory) -> Path:
    """The node in C++."""
    out = tmp_path_factory.mktemp("built")
    script = "g++ /nodes/waiter.cpp -o /out/waiter $(pkg-config --cflags --libs roscpp)"
    run_in_container(dockerd.host, ros_image, script, [f"{NODES}:/nodes:ro", f"{out}:/out"])
    return out


def registered(master: str) -> set[str]:
    """Names of all nodes that the master knows."""
    state = ros_master.call(master, "getSystemState", "/test")
    return {node.strip("/") for part in state for _, nodes in part for node in nodes}


def run_and_stop(robot: RealRobot, master: str, names: list[str]) -> dict[str, float]:
    """Seconds for which each was being stopped, once nobody wanted it."""
    before = {c.service: c.incarnation for c in robot.containers()}
    robot.request(*names)
    robot.wait(lambda: healthy(robot, *names) and all(before.get(n) != robot.run_of(n) for n in names))
    assert {*names} <= registered(master)
    robot.release()
    robot.wait(lambda: all(robot.states()[n] == "exited" for n in names))
    robot.settle()
    return {name: stop_seconds(robot, name) for name in names}


@pytest.mark.parametrize(
    "idle",
    [{"action": "stop"}, {"action": "pause", "escalate": {"after": "100ms", "action": "stop"}}],
    ids=["stop", "pause"],
)
def test_every_kind_of_program_ends_at_once_and_leaves_nothing_behind(docker_robot, ros_image, master, built, idle):
    tree = services(ros_image, master, *PROGRAMS)
    for name, command in PROGRAMS.items():
        tree[name] |= {"command": command, "idle": idle}
        tree[name]["container"] = {**tree[name]["container"], "volumes": [f"{NODES}:/nodes:ro", f"{built}:/built:ro"]}
    docker_robot.declare(tree, policies={"policy": {"purge_ros": False}})
    slow = [*PROGRAMS]
    for _ in range(ROUNDS):
        took = run_and_stop(docker_robot, master, slow)
        assert not registered(master) & {*slow}, "they have said goodbye"
        assert 137 not in {docker_robot.container(name).exit_code for name in slow}
        slow = [name for name in slow if took[name] >= LONGEST]
        if not slow:
            return
    raise AssertionError(f"each time longer than {LONGEST} s: {took}")


def test_without_the_profile_a_node_is_killed_and_stays_registered(docker_robot, ros_image, master, built):
    tree = services(ros_image, master, "cpp")
    tree["cpp"] |= {"command": PROGRAMS["cpp"], "profile": "plain", "needs": ["roscore"], "idle": {"action": "stop"}}
    options = {"network_mode": "host", "stop_signal": "SIGTERM", "stop_grace_period": "1s"}
    tree["cpp"]["container"] = {**tree["cpp"]["container"], **options, "volumes": [f"{built}:/built:ro"]}
    docker_robot.declare(tree, policies={"policy": {"purge_ros": False}})
    run_and_stop(docker_robot, master, ["cpp"])
    assert docker_robot.container("cpp").exit_code == 137
    assert "cpp" in registered(master)
