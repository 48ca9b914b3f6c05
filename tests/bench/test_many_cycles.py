"""The long version of tests/docker/test_work_cycles.py: CYCLES of each program (3400 by default; on Docker a tenth),
printed. rorg is left alone, stopped and killed, and its own container is upgraded."""

from __future__ import annotations

import os

import docker
import pytest
from cycle_robot import daemon, programs  # noqa: F401
from cycles import SERVICES, Restarts, cycle
from robots import RealRobot, write_tree
from rorg_client import Client

CYCLES = int(os.environ.get("CYCLES", "3400"))


def told(what: str, result, ends: int) -> None:
    print(
        f"\n{what}: {result.cycles} cycles, {len(result.wrong)} wrong, {len(result.errors)} errors, "
        f"longest {result.longest:.1f} s, {ends} times another rorg"
    )
    assert not result.wrong
    assert not result.errors


@pytest.mark.parametrize("restarts", [False, True])
def test_cycles(daemon, programs, restarts):  # noqa: F811
    count = CYCLES // (10 if daemon.robot.kind == "docker" else 1) // (5 if restarts else 1)
    ends = Restarts(daemon, every=30)
    result = cycle(daemon, programs, count, ends if restarts else lambda _: None)
    told(daemon.robot.kind, result, ends.count if restarts else 0)


class Upgrades:
    """rorg in a container of its own, with the mounts of docs/how-to/run.md; replaced after so many cycles."""

    def __init__(self, robot: RealRobot, folder, host_folder, image: str, every: int) -> None:
        self.robot, self.image, self.every, self.count = robot, image, every, 0
        self.api = docker.APIClient(robot.host, version="auto")
        self.binds = [f"{host_folder}:{host_folder}", f"{folder}:{folder}", "/sys/fs/cgroup:/sys/fs/cgroup:ro"]
        self.container = ""

    def start(self) -> None:
        self.container = self.api.create_container(
            self.image,
            ["run", str(self.robot.tree), "--engine", "docker"],
            environment={"RORG_STATE_DIR": str(self.robot.state.path), "DOCKER_HOST": self.robot.host},
            host_config=self.api.create_host_config(network_mode="host", pid_mode="host", binds=self.binds),
        )["Id"]
        self.api.start(self.container)

    def stop(self) -> None:
        self.api.stop(self.container, timeout=20)
        self.api.remove_container(self.container, force=True)

    def __call__(self, cycles: int) -> None:
        if cycles >= (self.count + 1) * self.every:
            self.count += 1
            self.stop()
            self.start()


def test_cycles_while_the_container_of_rorg_is_upgraded(dockerd, rorg_image, programs, tmp_path):  # noqa: F811
    robot = RealRobot(tmp_path, "docker", dockerd.host)
    write_tree(robot.tree, SERVICES)
    upgrades = Upgrades(robot, tmp_path, dockerd.folder, rorg_image, every=50)
    upgrades.start()
    try:
        Client(robot.socket(), patience=60).services()
        told("docker", cycle(upgrades, programs, max(20, CYCLES // 30), upgrades), upgrades.count)
    finally:
        upgrades.stop()
        robot.close()
