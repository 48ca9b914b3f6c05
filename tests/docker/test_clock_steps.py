"""A change is kept although its container or process began by a clock far ahead."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from dockerd import own_dockerd
from editions import edition
from robots import RealRobot
from updates import failed, running

from rorg.core.holds import begin_hold

FAR_AHEAD = "2076-01-01T12:00:00.000000Z"


@pytest.mark.slow
def test_a_good_change_of_a_process_that_began_by_a_clock_far_ahead_is_kept(tmp_path):
    """Its record has the time of its start: then NTP set the clock."""
    robot = RealRobot(tmp_path, "process", None)
    robot.declare(edition("old"))
    robot.wait(lambda: running(robot, "arm"))
    robot.settle()
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


@pytest.mark.slow
def test_a_hold_whose_end_is_wrong_by_the_clock_is_put_right_in_the_file(tmp_path):
    """As if it had been made in 2076, and NTP had set the clock then."""
    robot = RealRobot(tmp_path, "process", None)
    robot.declare({"arm": {"always_on": True}})
    robot.wait(lambda: running(robot, "arm"))
    held = begin_hold(robot.moment(), 4.0)
    robot.change(lambda asked: replace(asked, holds={"arm": replace(held, until=held.until + 50 * 365 * 86400.0)}))
    robot.wait(lambda: not running(robot, "arm"), 3)
    robot.wait(lambda: abs(until(robot) - held.until) < 1, 3)
    robot.wait(lambda: running(robot, "arm"), 20)
    assert robot.moment().uptime >= held.uptime
    robot.close()


def until(robot: RealRobot) -> float:
    """When the hold of the arm ends, by the file."""
    robot.file.read()
    return robot.file.document.holds["arm"].until
