"""How ROS 2 programs end under `profile: ros2`: by SIGINT, at once, and with nothing left in graph and memory."""

from __future__ import annotations

from pathlib import Path

import pytest
from robots import RealRobot
from ros2_programs import Hand, Ros2, read
from ros_stops import LONGEST, ROUNDS, stop_seconds

pytestmark = pytest.mark.docker
TALKER = "python3 /nodes/talker.py"
PROGRAMS = {
    "plain": (f"{TALKER} plain", {"plain"}),
    "shell": (["bash", "-c", f"{TALKER} shell; true"], {"shell"}),
    "both": (["bash", "-c", f"{TALKER} first & {TALKER} second; wait"], {"first", "second"}),
    "composed": (f"{TALKER} left right", {"left", "right"}),
}
"""Command, and the nodes that it runs."""


def graph(folder: Path) -> set[str]:
    file = folder / "graph"
    return set(read(file)) if file.exists() else set()


def test_every_kind_of_program_ends_at_once_and_leaves_nothing_behind(docker_robot: RealRobot, ros2: Ros2, tmp_path):
    docker_robot.shm.mkdir(mode=0o1777)
    memory = f"{docker_robot.shm}:/dev/shm"
    tree = {}
    for name, (command, _) in PROGRAMS.items():
        tree[name] = ros2.service(command, tmp_path, idle={"action": "stop"})
        tree[name]["container"]["volumes"].append(memory)
    hand = Hand(ros2, tmp_path, memory)
    try:
        hand.run("python3", "/nodes/watch.py", "/told/graph", detach=True)
        docker_robot.wait(lambda: (tmp_path / "graph").exists())
        docker_robot.declare(tree)
        slow = [*PROGRAMS]
        for _ in range(ROUNDS):
            took = run_and_stop(docker_robot, slow, tmp_path)
            assert not {docker_robot.container(name).exit_code for name in slow} & {137, 143}, "SIGINT ended them"
            slow = [name for name in slow if took[name] >= LONGEST]
            if not slow:
                break
        assert not slow, f"each time longer than {LONGEST} s: {took}"
        assert [*docker_robot.shm.glob("*fastdds_*")], "of the watcher"
        hand.run("pkill", "-INT", "-f", "watch.py")
        docker_robot.wait(lambda: not [*docker_robot.shm.glob("*fastdds_*")])
    finally:
        hand.close()


def run_and_stop(robot: RealRobot, names: list[str], folder: Path) -> dict[str, float]:
    """Seconds for which each was being stopped, after all its nodes were in the graph."""
    nodes = set().union(*(PROGRAMS[name][1] for name in names))
    robot.request(*names)
    robot.wait(lambda: graph(folder) >= nodes)
    robot.release()
    robot.wait(lambda: all(robot.states()[name] == "exited" for name in names))
    robot.settle()
    robot.wait(lambda: not graph(folder) & nodes, 10)  # DDS shows one that has not said goodbye for 20 s
    return {name: stop_seconds(robot, name) for name in names}
