"""A container on trial is ended by something else: a power cut, an engine that is killed, and rorg with it. That says
nothing about the change, so the trial is repeated."""

from __future__ import annotations

import os
import subprocess

import pytest
from common import wait_for
from dockerd import own_dockerd
from robots import Daemon, RealRobot, VirtualRobot, handed_on, write_tree
from trials import NEW, OLD, edition, on_trial, running, runs
from updates import later


def trial(robot: RealRobot) -> tuple[Daemon, str]:
    """A rorg with a new edition on trial, and the digest of that."""
    write_tree(robot.tree, edition(OLD))
    daemon = Daemon(robot)
    daemon.start()
    client = robot.client(patience=60.0)
    client.wait("nav", timeout=60)
    old = running(robot)
    write_tree(robot.tree, edition(NEW))
    new = wait_for(lambda: running(robot) not in ("", old) and running(robot), 60, "the new edition to run")
    wait_for(lambda: client.service("nav")["health"] == "Healthy", 60)
    return daemon, new


@pytest.mark.docker
@pytest.mark.parametrize("order", ["engine first", "rorg first", "engine restarted before rorg"])
def test_a_trial_that_ended_with_engine_and_rorg_is_repeated(tmp_path, order):
    with own_dockerd() as dockerd:
        robot = RealRobot(tmp_path, "docker", dockerd.host)
        daemon, new = trial(robot)
        if order == "engine first":
            dockerd.stop(kill=True)
            daemon.kill()
        else:
            daemon.kill()
            dockerd.stop(kill=True)
        if order == "engine restarted before rorg":
            dockerd.start()
            daemon.start()
        else:
            daemon.start()
            dockerd.start()
        wait_for(lambda: running(robot), 90, "an edition to run again")
        robot.client(patience=60.0).wait("nav", timeout=60)
        assert running(robot) == new
        daemon.stop()
        robot.close()


@pytest.mark.docker
@pytest.mark.parametrize("verb", ["stop", "kill"])
def test_a_trial_that_a_person_ends_by_hand_is_repeated(tmp_path, dockerd, verb):
    robot = RealRobot(tmp_path, "docker", dockerd.host)
    daemon, new = trial(robot)
    [container] = [c for c in robot.engine.list() if c.state == "running"]
    subprocess.run(["docker", verb, container.id], check=True, env={**os.environ, "DOCKER_HOST": dockerd.host})
    wait_for(lambda: [c for c in robot.engine.list() if c.state == "running" and c.started_at > container.started_at])
    robot.client(patience=60.0).wait("nav", timeout=60)
    assert running(robot) == new
    daemon.stop()
    robot.close()


@pytest.mark.slow
def test_a_trial_that_was_killed_while_no_rorg_ran_is_repeated(tmp_path):
    robot = RealRobot(tmp_path, "process", None)
    daemon, new = trial(robot)
    daemon.kill()
    robot.kill("nav")
    wait_for(lambda: not running(robot), 10)
    daemon.start()
    wait_for(lambda: running(robot), 60, "an edition to run again")
    robot.client(patience=60.0).wait("nav", timeout=60)
    assert running(robot) == new
    daemon.stop()
    robot.close()


@pytest.mark.parametrize("code", [0, 1, 137, 143])
@pytest.mark.parametrize("rebooted", [True, False], ids=["power cut", "kill of rorg"])
def test_an_edition_that_is_interrupted_each_time_fails_at_last(tmp_path, code, rebooted):
    """It may be what takes the machine down."""
    virtual = VirtualRobot(tmp_path)
    digest = on_trial(virtual)
    for time in range(3):
        later(virtual, 10)
        assert runs(virtual) == digest, f"interrupted {time} times"
        virtual.sim.engine.kill(virtual.container("nav").id, code)
        virtual.sim.reborn(handed_on(virtual.sim.decision, rebooted=rebooted))
    later(virtual, 30)
    assert runs(virtual) not in ("", digest)
    assert virtual.waits("nav").startswith(f"its change failed (ended with exit code {code})")


def test_another_edition_is_tried_as_often(tmp_path):
    virtual = VirtualRobot(tmp_path)
    on_trial(virtual)
    virtual.sim.engine.kill(virtual.container("nav").id)
    virtual.sim.reborn(handed_on(virtual.sim.decision))
    later(virtual, 10)
    assert virtual.sim.memory.of("nav").update.interrupted == 1
    virtual.declare(edition({"EDITION": "newer"}))
    later(virtual, 10)
    assert virtual.sim.memory.of("nav").update.interrupted == 0
