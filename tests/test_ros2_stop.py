"""How ROS 2 programs end under `profile: ros2`: by SIGINT, at once, and with nothing left in graph and memory."""

from __future__ import annotations

import pytest
from robots import RealRobot
from ros2_programs import Hand, Ros2, read
from test_ros_stop import LONGEST, ROUNDS, stop_seconds

pytestmark = pytest.mark.docker
TALKER = "python3 /nodes/talker.py"
PROGRAMS = {
    "plain": (f"{TALKER} plain", {"plain"}),
    "shell": (["bash", "-c", f"{TALKER} shell; true"], {"shell"}),
    "both": (["bash", "-c", f"{TALKER} first & {TALKER} second; wait"], {"first", "second"}),
    "composed": (f"{TALKER} left right", {"left", "right"}),
}
"""Command, and the nodes that it runs."""
ALL = set().union(*(nodes for _, nodes in PROGRAMS.values()))


def graph(folder) -> set[str]:
    file = folder / "graph"
    return set(read(file)) if file.exists() else set()


def test_every_kind_of_program_ends_at_once_and_leaves_nothing_behind(docker_robot: RealRobot, ros2: Ros2, tmp_path):
    docker_robot.shm.mkdir(mode=0o1777)
    memory = f"{docker_robot.shm}:/dev/shm"
    tree = {}
    for name, (command, _) in PROGRAMS.items():
        tree[name] = ros2.service(command, tmp_path, ready={"log": "talks"}, idle={"action": "stop"})
        tree[name]["container"]["volumes"].append(memory)
    hand = Hand(ros2, tmp_path, memory)
    try:
        hand.run("python3", "/nodes/watch.py", "/told/graph", detach=True)
        docker_robot.wait(lambda: (tmp_path / "graph").exists())
        docker_robot.declare(tree, policies={"policy": {"purge_shm": False}})
        before = files(docker_robot)
        slow, took = [*PROGRAMS], {}
        for _ in range(ROUNDS):
            docker_robot.request(*slow)
            docker_robot.wait(lambda: graph(tmp_path) >= set().union(*(PROGRAMS[n][1] for n in slow)))  # noqa: B023
            docker_robot.release()
            docker_robot.wait(lambda: all(docker_robot.states()[n] == "exited" for n in slow))  # noqa: B023
            docker_robot.settle()
            docker_robot.wait(
                lambda: not graph(tmp_path) & ALL,
                5,
            )
            assert files(docker_robot) == before
            assert not {docker_robot.container(name).exit_code for name in slow} & {137, 143}, "SIGINT ended them"
            took = {name: stop_seconds(docker_robot, name) for name in slow}
            slow = [name for name in slow if took[name] >= LONGEST]
            if not slow:
                return
        raise AssertionError(f"each time longer than {LONGEST} s: {took}")
    finally:
        hand.close()


def files(robot: RealRobot) -> set[str]:
    return {path.name for path in robot.shm.iterdir()}
