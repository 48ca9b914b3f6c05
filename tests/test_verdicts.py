"""A verdict that others act on rests on a look at the container, and on answers of its probes, that began after the
moment of which it speaks. Without them it is open: what is known from before proves nothing."""

from __future__ import annotations

import os
import signal
from contextlib import contextmanager

import pytest
from forwarder import Forwarder
from robots import RealRobot
from test_updates import failed, identity

ON = {"always_on": True}


def dies_after(seconds: float) -> list[str]:
    return ["sh", "-c", f"sleep {seconds}; exit 7"]


@pytest.fixture
def forwarder(dockerd):
    found = Forwarder(dockerd.host)
    yield found
    found.close()


@pytest.fixture
def behind(forwarder, tmp_path):
    """A robot whose engine is reached through the forwarder."""
    found = RealRobot(tmp_path, "docker", forwarder.host)
    yield found
    forwarder.silent, forwarder.slow_start = False, 0.0
    found.close()


def goes_back(robot, before: tuple[str, str]) -> None:
    """The container from before runs again, alone, and the change has failed."""
    robot.wait(lambda: failed(robot, "arm"), 120)
    robot.wait(lambda: [c.id for c in robot.containers() if c.state == "running"] == [before[0]], 120)
    robot.wait(lambda: [c.id for c in robot.containers()] == [before[0]], 120)
    assert "exit code 7" in failed(robot, "arm")


def on_trial(robot, before: tuple[str, str]) -> bool:
    step = robot.loop.memory.of("arm")
    return step.well_since is not None and not step.incarnation.startswith(before[0][:12])


@contextmanager
def stopped(dockerd):
    os.kill(dockerd.process.pid, signal.SIGSTOP)
    try:
        yield
    finally:
        os.kill(dockerd.process.pid, signal.SIGCONT)


def test_an_engine_that_is_stopped_during_a_bake_proves_nothing(dockerd, docker_robot):
    robot = docker_robot
    robot.declare({"arm": ON})
    robot.settle()
    before = identity(robot, "arm")
    robot.declare({"arm": {**ON, "command": dies_after(1), "update": {"bake": "2s"}}})
    robot.wait(lambda: on_trial(robot, before))
    since = robot.loop.clock()
    with stopped(dockerd):
        robot.wait(lambda: robot.loop.clock() > since + 5)
    goes_back(robot, before)


def test_silent_events_prove_nothing(behind, forwarder):
    behind.declare({"arm": ON})
    behind.settle()
    before = identity(behind, "arm")
    forwarder.silent = True
    behind.declare({"arm": {**ON, "command": dies_after(1), "update": {"bake": "2s"}}})
    goes_back(behind, before)


def test_a_bake_does_not_count_while_the_start_is_not_answered(behind, forwarder):
    """The container dies while the answer of its start is under way."""
    behind.declare({"arm": ON})
    behind.settle()
    before = identity(behind, "arm")
    forwarder.silent, forwarder.slow_start = True, 1.0
    behind.declare({"arm": {**ON, "command": dies_after(1.5), "update": {"bake": "1s"}}})
    goes_back(behind, before)
