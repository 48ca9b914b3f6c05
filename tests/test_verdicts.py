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
    forwarder.silent = False
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


# -- what rorg stopped is no crash -----------------------------------------------------------------------------


def test_changes_and_reverts_during_a_bake_are_no_crashes(real_robot):
    robot = real_robot
    stops = {"always_on": True, "command": ["sh", "-c", "trap 'exit 130' INT; while :; do sleep .05; done"]}
    stops |= {"container": {"stop_signal": "SIGINT"}, "update": {"bake": "1h"}}
    robot.declare({"arm": stops})
    robot.settle()
    for n in (1, 2, 0, 3, 0):  # 0 is a revert
        more = {"environment": {"N": str(n)}} if n else {}
        robot.declare({"arm": {**stops, "container": {**stops["container"], **more}}})
        robot.wait(lambda more=more: serves(robot, "arm", more.get("environment", {})))
    step = robot.loop.memory.of("arm")
    assert (step.crashes, step.exits, step.error) == (0, 0, "")
    assert not [line for line in robot.lines if "unexpected" in line]


def serves(robot, name: str, environment: dict[str, str]) -> bool:
    """What is declared has been read and runs, and rorg has nothing under way."""
    desired, step = robot.loop.tree.desired, robot.loop.memory.of(name)
    said = desired.catalog.services[name].spec.get("environment", {})
    return (
        said.get("N") == environment.get("N")
        and robot.container(name).digest == desired.digests[name]
        and step.well_since is not None
        and step.update.edition == desired.editions[name]
        and not robot.loop.memory.in_flight
    )
