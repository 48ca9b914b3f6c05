"""A container that the engine cannot remove (moby#22312): nothing waits for it, and its removal is tried again."""

from __future__ import annotations

import os
import subprocess
from contextlib import contextmanager
from pathlib import Path

import commands
import pytest
from robots import VirtualRobot
from tools import tool

ALWAYS = {"always_on": True, "update": {"bake": "0s"}}
CHANGED = {**ALWAYS, "container": {"hostname": "other"}}


@contextmanager
def stuck(folder: Path):
    """A folder of the engine with a file that nobody can delete."""
    file = folder / "stuck"
    file.touch()
    subprocess.run([tool("chattr"), "+i", file], check=True)
    try:
        yield
    finally:
        subprocess.run([tool("chattr"), "-i", file], check=True)


def said(robot, *words: str) -> tuple[int, str]:
    done = commands.run([*words], {**os.environ, "RORG_STATE_DIR": str(robot.state.path), "RORG_ENGINE": "docker"})
    return done.returncode, done.stdout + done.stderr


def test_nothing_waits_for_a_container_that_docker_cannot_remove(docker_robot, dockerd):
    if dockerd.podman:
        pytest.skip("Podman keeps its containers elsewhere")
    robot = docker_robot
    robot.declare({"nav": ALWAYS})
    robot.wait(lambda: robot.active() == {"nav"})
    robot.settle()
    old = robot.container("nav").id
    with stuck(dockerd.folder / "data/containers" / old):
        robot.declare({"nav": CHANGED})
        robot.wait(lambda: robot.container("nav").id != old and robot.active() == {"nav"})
        robot.wait(lambda: f"the engine does not remove its container {old[:12]}" in robot.waits("nav"))
        states = {c.id: c.state for c in robot.containers()}
        assert states[old] == "dead", states
        first = robot.run_of("nav")
        robot.kill("nav")
        robot.wait(lambda: robot.container("nav").state == "running" and robot.container("nav").incarnation != first)
        robot.wait(lambda: "operation not permitted" in robot.status()["services"]["nav"]["message"])
        assert "does not remove" in said(robot, "doctor")[1]
        assert "does not remove" in said(robot, "get")[1]
    robot.wait(lambda: [c.name for c in robot.containers()] == ["nav"], 120)


def test_the_robot_goes_down_beside_a_container_that_docker_cannot_remove(docker_robot, dockerd):
    if dockerd.podman:
        pytest.skip("Podman keeps its containers elsewhere")
    robot = docker_robot
    robot.declare({"nav": ALWAYS, "cam": ALWAYS})
    robot.wait(lambda: robot.active() == {"nav", "cam"})
    robot.settle()
    robot.stop()
    old = robot.container("nav").id
    with stuck(dockerd.folder / "data/containers" / old):
        code, text = said(robot, "down", "--yes")
        assert code == 0, text
        assert "the robot is down" in text
        assert f"the engine does not remove {old[:12]}" in text
        assert [(c.id, c.state) for c in robot.containers()] == [(old, "dead")]


def later(robot: VirtualRobot, seconds: float) -> None:
    end = robot.now() + seconds
    robot.sim.at(end, lambda: None)
    robot.wait(lambda: robot.now() >= end, 2 * seconds)


@pytest.mark.parametrize("state", ["removing", "dead"])
def test_a_crashed_service_restarts_beside_a_container_that_is_not_removed(tmp_path, state):
    robot = VirtualRobot(tmp_path)
    robot.declare({"nav": ALWAYS})
    robot.settle()
    old = robot.container("nav").id
    robot.sim.faults.unremovable[old] = state
    robot.declare({"nav": CHANGED})
    robot.wait(lambda: {c.state for c in robot.containers()} == {"running", state})
    robot.kill("nav")
    robot.wait(lambda: {c.state for c in robot.containers()} == {"running", state}, 10)
    tries = len(robot.log())
    later(robot, 600)
    tries = len(robot.log()) - tries
    assert (10 <= tries <= 20) if state == "dead" else not tries, "with back-off, for as long as it takes"
    robot.wait(lambda: robot.waits("nav").startswith("the engine does not remove its container"))
    robot.sim.faults.unremovable.clear()
    if state == "removing":
        del robot.sim.engine.containers[old]
    robot.wait(lambda: [c.name for c in robot.containers()] == ["nav"], 120)
