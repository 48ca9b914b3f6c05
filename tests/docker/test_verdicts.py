"""A verdict that others act on rests on a look at the container, and on answers of its probes, that began after the
moment of which it speaks. Without them it is open: what is known from before proves nothing."""

from __future__ import annotations

import os
import signal
from contextlib import contextmanager

import pytest
from commands import rorg
from forwarder import Forwarder
from robots import RealRobot, VirtualRobot
from standing import stands
from updates import failed, identity, later, retry

ON = {"always_on": True}


def dies_after(seconds: float) -> list[str]:
    return ["python3", "-S", "-c", f"import time; time.sleep({seconds}); raise SystemExit(7)"]


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
    step = robot.loop.running.memory.of("arm")
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
    robot.declare({"arm": {**ON, "command": dies_after(2), "update": {"bake": "4s"}}})
    robot.wait(lambda: on_trial(robot, before))
    since = robot.loop.clock()
    with stopped(dockerd):
        robot.wait(lambda: robot.loop.clock() > since + 6)
    goes_back(robot, before)


def test_silent_events_prove_nothing(behind, forwarder):
    behind.declare({"arm": ON})
    behind.settle()
    before = identity(behind, "arm")
    forwarder.silent = True
    behind.declare({"arm": {**ON, "command": dies_after(1), "update": {"bake": "2s"}}})
    goes_back(behind, before)


# -- whoever changes probes changes what is proven -------------------------------------------------------------


@pytest.fixture
def virtual(tmp_path):
    return VirtualRobot(tmp_path)


def test_a_change_of_ready_alone_is_proven_by_its_answers(virtual):
    virtual.declare({"nav": {**ON, "ready": {"tcp": 1}}})
    virtual.settle()
    later(virtual, 10)
    assert stands(virtual) == "good"
    run = virtual.container("nav").incarnation
    virtual.sim.ready_after["nav"] = 1e9
    virtual.declare({"nav": {**ON, "ready": {"tcp": 2, "timeout": "20s"}}})
    later(virtual, 19)
    assert stands(virtual) == "baking"
    later(virtual, 4)
    assert stands(virtual) == "failed", "it had the time of its probe, after its bake"
    assert virtual.sim.memory.of("nav").ready, "it answered the probe that it was proven with"
    assert virtual.container("nav").incarnation == run
    virtual.sim.ready_after.clear()
    virtual.declare({"nav": {**ON, "ready": {"tcp": 3}}})
    later(virtual, 5)
    assert stands(virtual) == "good"
    assert virtual.container("nav").incarnation == run


def test_a_change_of_live_alone_is_proven_by_its_answers(virtual):
    virtual.declare({"nav": {**ON, "ready": {"tcp": 1}}})
    virtual.settle()
    later(virtual, 10)
    virtual.sim.hung.add(virtual.container("nav").incarnation)
    virtual.declare({"nav": {**ON, "ready": {"tcp": 1}, "live": {"tcp": 1}}})
    seen = []
    virtual.wait(lambda: seen.append(stands(virtual)) or stands(virtual) == "failed")
    assert "good" not in seen
    assert not virtual.sim.memory.of("nav").crashes
    virtual.sim.hung.clear()
    retry(virtual, "nav")
    later(virtual, 10)
    assert stands(virtual) == "good"


def standings(robot) -> list[tuple[str, str]]:
    """Of all revisions, the newest last, each with why."""
    found = robot.loop.recorder.historian.revisions.list(10)
    return [(r.standing, r.reason) for r in reversed(found)]


@pytest.fixture(params=["process", pytest.param("docker", marks=pytest.mark.docker)])
def served(request, tmp_path):
    """A robot whose rorg commands can ask."""
    host = request.getfixturevalue("dockerd").host if request.param == "docker" else None
    found = RealRobot(tmp_path, request.param, host, with_server=True)
    yield found
    found.close()


@pytest.mark.slow
def test_a_revision_that_breaks_ready_bakes_until_that_has_answered_and_fails(served, tmp_path):
    robot = served
    mark = tmp_path / "mark" if robot.kind == "process" else "/mark"
    robot.declare({"arm": {**ON, "ready": {"exec": ["sh", "-c", "true"]}}})
    robot.wait(lambda: standings(robot)[-1:] == [("good", "")])
    before = identity(robot, "arm")
    waits = {"exec": ["sh", "-c", f"test -e {mark}"], "interval": "100ms", "timeout": "1h"}
    robot.declare({"arm": {**ON, "ready": waits}})
    robot.wait(lambda: standings(robot)[-1] == ("baking", "being watched for 2 s: arm"))
    robot.wait(lambda: (robot.status()["tree"]["standing"] or {})["code"] == "baking")
    told = rorg("get", RORG_SOCKET=robot.socket()).stderr
    assert "manifests are baking: being watched for 2 s: arm" in told
    robot.engine.exec(robot.container("arm").id, ["python3", "-c", f"open({str(mark)!r}, 'w')"], 10)
    robot.wait(lambda: standings(robot)[-1] == ("good", ""))
    robot.declare({"arm": {**ON, "ready": {"exec": ["sh", "-c", "false"], "timeout": "2s"}}})
    robot.wait(lambda: standings(robot)[-1][0] == "failed")
    assert [code for code, _ in standings(robot)] == ["good", "good", "failed"]
    assert "not ready within 2 s" in standings(robot)[-1][1]
    assert identity(robot, "arm") == before


@pytest.mark.slow
def test_a_failure_that_is_reverted_at_once_stays_one(real_robot):
    robot = real_robot
    robot.declare({"arm": ON})
    robot.wait(lambda: standings(robot)[-1:] == [("good", "")])
    robot.declare({"arm": {**ON, "command": dies_after(0.1), "update": {"bake": "20s"}}})
    robot.wait(lambda: robot.loop.running.memory.of("arm").update.quarantined)
    robot.declare({"arm": ON})
    robot.wait(lambda: len(standings(robot)) == 3 and standings(robot)[-1][0] == "good")
    assert standings(robot)[1] == ("failed", "arm: ended with exit code 7")
    told = [e["message"] for e in robot.loop.recorder.journal.since(0) if e["kind"] == "crashed"]
    assert told == ["arm ended with exit code 7 (unexpected exit 1)"]


# -- what rorg stopped is no crash -----------------------------------------------------------------------------


@pytest.mark.slow
def test_changes_and_reverts_during_a_bake_are_no_crashes(real_robot):
    robot = real_robot
    ends = "import os, signal\nsignal.signal(2, lambda *_: os._exit(130))\nwhile True: signal.pause()"
    stops = {**ON, "command": ["python3", "-S", "-c", ends]}
    stops |= {"container": {"stop_signal": "SIGINT"}, "update": {"bake": "1h"}}
    robot.declare({"arm": stops})
    robot.settle()
    for n in (1, 2, 0, 3, 0):  # 0 is a revert
        more = {"environment": {"N": str(n)}} if n else {}
        robot.declare({"arm": {**stops, "container": {**stops["container"], **more}}})
        robot.wait(lambda more=more: serves(robot, "arm", more.get("environment", {})))
    step = robot.loop.running.memory.of("arm")
    assert (step.crashes, step.exits, step.error) == (0, 0, "")
    assert not [line for line in robot.lines if "unexpected" in line]


def serves(robot, name: str, environment: dict[str, str]) -> bool:
    """What is declared has been read and runs, and rorg has nothing under way."""
    desired, step = robot.loop.tree.desired, robot.loop.running.memory.of(name)
    said = desired.catalog.services[name].spec.get("environment", {})
    return (
        said.get("N") == environment.get("N")
        and robot.container(name).digest == desired.digests[name]
        and step.well_since is not None
        and step.update.edition == desired.editions[name]
        and not robot.loop.running.memory.in_flight
    )
