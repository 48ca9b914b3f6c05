"""The machine's clock is set: back by NTP on a robot without a battery, or ahead. Nothing that rorg decides depends on
it."""

from __future__ import annotations

import json

import pytest
from dockerd import own_dockerd
from robots import RealRobot, VirtualRobot
from test_updates import failed, later, running

STEPS = (-50 * 365 * 86400.0, -3600.0, -20.0, 20.0, 3600.0, 50 * 365 * 86400.0)
"""Seconds by which the clock is set."""


def edition(word: str, **more) -> dict:
    return {"arm": {"always_on": True, "container": {"environment": {"EDITION": word}}, **more}}


@pytest.fixture
def virtual(tmp_path):
    return VirtualRobot(tmp_path)


@pytest.mark.parametrize("seconds", STEPS)
def test_a_good_change_after_the_clock_was_set_is_kept(virtual, seconds):
    virtual.declare(edition("old"))
    virtual.settle()
    virtual.sim.clock_set = seconds
    virtual.declare(edition("new"))
    digest = virtual.sim.desired.digests["arm"]
    virtual.settle()
    assert running(virtual, "arm").digest == digest
    assert not virtual.sim.memory.of("arm").update.failed


@pytest.mark.parametrize("seconds", STEPS)
def test_a_bad_change_after_the_clock_was_set_is_undone(virtual, seconds):
    virtual.declare(edition("old"))
    virtual.settle()
    old = running(virtual, "arm").id
    virtual.sim.clock_set = seconds
    virtual.declare(edition("bad"))
    virtual.sim.faults.bad[virtual.sim.desired.digests["arm"]] = "exit"
    later(virtual, 30)
    assert running(virtual, "arm").id == old
    assert virtual.sim.memory.of("arm").update.failed == "ended with exit code 1"


FAR_AHEAD = "2076-01-01T12:00:00.000000Z"


def test_a_good_change_of_a_process_that_began_by_a_clock_far_ahead_is_kept(tmp_path):
    """Its record has the time of its start: then NTP set the clock."""
    robot = RealRobot(tmp_path, "process", None)
    robot.declare(edition("old"))
    robot.wait(lambda: running(robot, "arm"))
    record = robot.engine.records.read(running(robot, "arm").id)
    robot.engine.records.write({**record, "started_at": FAR_AHEAD, "created_at": FAR_AHEAD})
    robot.engine.changes.tell(record["id"])
    change_well(robot)


@pytest.mark.docker
def test_a_good_change_of_a_container_that_began_by_a_clock_far_ahead_is_kept(tmp_path):
    with own_dockerd("--live-restore") as dockerd:
        robot = RealRobot(tmp_path, "docker", dockerd.host)
        robot.declare(edition("old"))
        robot.wait(lambda: running(robot, "arm"))
        robot.settle()
        robot.stop()
        path = dockerd.folder / f"data/containers/{robot.container('arm').id}/config.v2.json"
        dockerd.stop()
        kept = json.loads(path.read_text())
        kept["State"]["StartedAt"] = kept["Created"] = FAR_AHEAD
        path.write_text(json.dumps(kept))
        dockerd.start()
        robot.start()
        change_well(robot)


def change_well(robot: RealRobot) -> None:
    """Change the arm, whose run began in 2076 by its engine, in a way that works."""
    try:
        robot.wait(lambda: robot.status()["services"]["arm"]["started_at"].startswith("2076"))
        old = robot.container("arm").id
        robot.declare(edition("new"))
        robot.wait(lambda: failed(robot, "arm") or (robot.quiet() and running(robot, "arm").id != old))
        assert not failed(robot, "arm")
    finally:
        robot.close()
