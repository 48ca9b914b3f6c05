"""An engine that is frozen (SIGSTOP) or stopped: rorg says so within seconds, calls nothing ready, and resumes itself
when the engine does."""

from __future__ import annotations

import json
import os
import signal
import threading
import time

import commands
import pytest
from common import wait_for
from frozen import frozen, silent
from robots import write_tree
from rorg_client import NotReady, Unreachable

from rorg.engines.docker.client import ANSWER
from rorg.engines.docker.engine import DockerEngine
from rorg.engines.heartbeat import EVERY

pytestmark = pytest.mark.docker
NOTICED = EVERY + ANSWER
"""Seconds after which a frozen engine must have been noticed."""
SLACK = 5.0
"""How much longer things take on a machine that does much else."""


@pytest.fixture
def robot(docker_robot, dockerd):
    docker_robot.with_server = True
    docker_robot.declare({"arm": {"always_on": True}, "lidar": {"always_on": True}})
    docker_robot.wait(lambda: docker_robot.active() == {"arm", "lidar"})
    docker_robot.settle()
    yield docker_robot
    wait_for(lambda: docker_robot.client().call("GET", "/v1/engine")["complete"], 60, "the engine to answer again")


def programs(robot, service: str) -> int:
    """The process id of a service's program."""
    return int(robot.client().service(service)["pid"])


def test_a_frozen_engine_is_noticed_and_nothing_is_called_healthy(robot, dockerd):
    client, pid = robot.client(), programs(robot, "arm")
    with frozen(dockerd):
        began = time.monotonic()
        os.kill(pid, signal.SIGKILL)
        wait_for(lambda: silent(robot), 60)
        assert time.monotonic() - began < NOTICED * SLACK
        arm = client.service("arm")
        ready = next(c for c in arm["conditions"] if c["type"] == "Ready")
        assert (arm["health"], ready["status"], ready["reason"]) == ("Unknown", "Unknown", "EngineSilent")
        engine = client.status()["engine"]
        assert (engine["address"], engine["complete"]) == (dockerd.host, False)
        assert "has not answered since" in engine["error"]
        assert not client.readiness("arm")["arm"]["ready"]
    wait_for(lambda: not silent(robot), 60)
    robot.wait(lambda: client.service("arm")["health"] == "Healthy" and programs(robot, "arm") != pid)


def test_a_wait_does_not_believe_what_it_cannot_check(robot, dockerd):
    """Asked at the moment at which the engine freezes, before anybody can have noticed."""
    client, pid = robot.client(), programs(robot, "arm")
    with frozen(dockerd):
        os.kill(pid, signal.SIGKILL)
        with pytest.raises(NotReady) as told:
            client.wait("arm", timeout=NOTICED + 1)
        assert f"the engine at {dockerd.host} has not answered since" in str(told.value)
        assert not told.value.services["arm"]["ready"]
        waiting = threading.Thread(target=client.wait, args=("arm",), kwargs={"timeout": 60})
        waiting.start()
    waiting.join(60)
    assert not waiting.is_alive()
    assert programs(robot, "arm") not in (0, pid)


def test_a_stopped_engine_is_told_above_every_table(robot, dockerd):
    if not hasattr(dockerd, "folder"):
        pytest.skip("somebody else runs this engine")
    dockerd.stop(kill=True)
    try:
        wait_for(lambda: silent(robot), 60)
        done = commands.rorg("get", "--state-dir", str(robot.state.path))
        assert f"the engine at {dockerd.host} has not answered since" in done.stderr.splitlines()[0]
        assert "Healthy" not in done.stdout
        with pytest.raises(Unreachable, match="has not answered since"):
            robot.client(patience=0.0).call("GET", "/v1/diff")
    finally:
        dockerd.start()
    robot.wait(lambda: robot.client().service("arm")["health"] == "Healthy")


def test_what_programs_read_names_it_too(robot, dockerd):
    words = "--state-dir", str(robot.state.path), "-o", "json"
    with frozen(dockerd):
        wait_for(lambda: silent(robot), 60)
        told = f"the engine at {dockerd.host} has not answered since"
        (arm,) = [s for s in json.loads(commands.rorg("get", *words).stdout) if s["service"] == "arm"]
        assert told in next(c["message"] for c in arm["conditions"] if c["type"] == "Ready")
        assert told in json.loads(commands.rorg("why", "arm", *words).stdout)["waits"][0]
        assert told in json.loads(commands.rorg("describe", "arm", *words).stdout)["log"][0]
        assert told in json.loads(commands.rorg("top", "--once", *words).stdout)["engine"]["error"]


def test_an_rorg_that_begins_on_a_frozen_engine_claims_nothing(docker_robot, dockerd):
    docker_robot.with_server = True
    write_tree(docker_robot.tree, {"arm": {"always_on": True}})
    with frozen(dockerd):
        docker_robot.start()
        wait_for(lambda: silent(docker_robot), 60)
        arm = docker_robot.client().service("arm")
        assert (arm["state"], arm["sync"], arm["health"]) == ("unknown", "Unknown", "Unknown")
    docker_robot.wait(lambda: docker_robot.client().service("arm")["health"] == "Healthy")


def test_a_loss_is_not_told_of_what_is_merely_not_known(robot, dockerd):
    client = robot.client()
    with client.request("lidar", id="watch", wait=60):
        with frozen(dockerd):
            wait_for(lambda: silent(robot), 60)
        wait_for(lambda: not silent(robot), 60)
        client.wait("lidar", timeout=60)
        assert not [e for e in client.events(tail=1000) if e["kind"] == "lost"]


def test_no_call_is_made_of_a_silent_engine_and_hung_ones_go_on(robot, dockerd):
    client = robot.client()
    with frozen(dockerd):
        client.restart("arm")
        wait_for(lambda: silent(robot), 60)
        passes = robot.loop.passes
        with client.request("lidar", id="meanwhile"):
            wait_for(lambda: robot.loop.passes > passes, 60, "a pass beside a hung call")
        assert len(robot.loop.running.memory.in_flight) <= 1
    run = client.service("arm")["incarnation"]
    robot.wait(lambda: client.service("arm")["health"] == "Healthy")
    robot.wait(lambda: client.service("arm")["incarnation"] != run or not robot.loop.running.memory.in_flight)


def test_a_read_is_given_up_when_the_engine_does_not_answer_a_ping(dockerd):
    engine = DockerEngine("nobody", dockerd.host)
    engine.ping()
    with frozen(dockerd):
        began = time.monotonic()
        from rorg.errors import TimedOut, Unreachable

        with pytest.raises(Unreachable, match=f"the engine at {dockerd.host} does not answer") as told:
            engine.list()
        assert not isinstance(told.value, TimedOut)
        assert time.monotonic() - began < NOTICED * SLACK
    assert engine.list() == []
