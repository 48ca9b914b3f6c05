"""A program that ended without the engine noticing: what tells the engine of ends was killed with it."""

from __future__ import annotations

import json
import os
from dataclasses import replace

import psutil
import pytest
from commands import rorg
from common import wait_for
from dockerd import Dockerd, own_dockerd
from robots import RealRobot

pytestmark = pytest.mark.docker


def lose(dockerd: Dockerd, pid: int) -> None:
    """End a program and its shim while containerd looks away; then containerd, which dockerd starts again. Measured on
    Docker 20.10: it calls the container running for ever, with this pid."""
    containerd = [p for p in psutil.Process(dockerd.process.pid).children(recursive=True) if p.name() == "containerd"]
    shim = psutil.Process(pid).parent()
    for process in containerd:
        process.suspend()
    shim.kill()
    os.kill(pid, 9)
    wait_for(lambda: not psutil.pid_exists(pid) or psutil.Process(pid).status() == psutil.STATUS_ZOMBIE, 10)
    for process in containerd:
        process.kill()


def test_a_program_whose_end_the_engine_missed_is_started_again(tmp_path):
    with own_dockerd("--live-restore") as dockerd:
        robot = RealRobot(tmp_path, "docker", dockerd.host, with_server=True)
        robot.declare({"arm": {"always_on": True}, "base": {"always_on": True}})
        robot.wait(lambda: robot.active() == {"arm", "base"})
        robot.wait(lambda: robot.loop.decision.memory.of("arm").update.baked)
        before, other = robot.container("arm"), robot.run_of("base")
        lose(dockerd, before.pid)
        assert robot.engine.inspect(before.id).state == "running", "so says the engine"
        robot.wait(lambda: any("but its process has ended (unexpected exit 1)" in line for line in robot.lines), 30)
        robot.wait(lambda: robot.container("arm").pid not in (0, before.pid) and robot.quiet(), 60)
        assert robot.client().service("arm")["health"] == "Healthy"
        assert robot.run_of("base") == other
        robot.close()


def test_while_the_engine_cannot_end_it_rorg_names_what_is_wrong(tmp_path):
    with own_dockerd("--live-restore") as dockerd:
        robot = RealRobot(tmp_path, "docker", dockerd.host, with_server=True)
        robot.declare({"arm": {"always_on": True}, "base": {"always_on": True}})
        robot.wait(lambda: robot.active() == {"arm", "base"})
        robot.settle()
        robot.suspend(60)
        lose(dockerd, robot.container("arm").pid)
        client = robot.client()
        robot.wait(lambda: client.service("arm")["health"] == "Degraded", 30)
        ready = next(c for c in client.service("arm")["conditions"] if c["type"] == "Ready")
        assert (ready["reason"], ready["message"]) == (
            "Vanished",
            "the engine calls it running, but its process has ended",
        )
        assert client.service("base")["health"] == "Healthy"
        told = rorg("doctor", "-o", "json", RORG_STATE_DIR=str(robot.state.path), DOCKER_HOST=dockerd.host)
        (check,) = [c for c in json.loads(told.stdout) if c["check"] == "service arm"]
        assert (check["status"], check["message"]) == ("warning", ready["message"])
        why = rorg("why", "arm", RORG_STATE_DIR=str(robot.state.path), DOCKER_HOST=dockerd.host).stdout
        assert ready["message"] in why
        robot.change(lambda asked: replace(asked, suspended=None))
        robot.wait(lambda: client.service("arm")["health"] == "Healthy", 60)
        robot.close()
