"""Whom pressure sheds, one at a time, and when each comes back."""

from __future__ import annotations

import pytest
from pressed_robots import POLICY, service
from robots import VirtualRobot
from shed import shed
from virtual_time import later


@pytest.fixture
def robot(tmp_path):
    return VirtualRobot(tmp_path)


@pytest.fixture
def crowd(robot):
    """One that matters, and five of 0.3 cores each, of 2.0 in all."""
    robot.declare(
        {"base": service(0.5, "1Gi", 90), **{f"n{i}": service(0.3, "1Mi", 20 + i) for i in range(5)}}, policies=POLICY
    )
    robot.request("base", *(f"n{i}" for i in range(5)))
    robot.wait(lambda: len(robot.active()) == 6)
    later(robot, 5)
    return robot


def test_nobody_else_is_shed_while_the_first_one_is_still_stopping(crowd):
    crowd.sim.faults.hang = {("stop", f"n{i}"): 8.0 for i in range(5)}
    crowd.sim.extra = (0.2, 0)
    later(crowd, 20)
    assert shed(crowd) == ["n0"]
    assert len(crowd.active()) == 5


def test_what_never_stops_does_not_keep_the_machine_under_pressure(crowd):
    crowd.sim.faults.hang["stop", "n0"] = 1000.0
    crowd.sim.extra = (0.2, 0)
    crowd.wait(lambda: "n1" not in crowd.active(), 60)


def test_nothing_is_shed_while_nothing_may_be_changed(crowd):
    crowd.suspend(20.0)
    crowd.sim.extra = (0.2, 0)
    later(crowd, 19)
    assert shed(crowd) == []
    crowd.wait(lambda: "n0" not in crowd.active())
    later(crowd, 10)
    assert shed(crowd) == ["n0"]


def test_a_service_that_must_not_be_touched_is_not_chosen(robot):
    robot.declare(
        {
            "base": service(0.5, "1Gi", 90),
            "arm": service(0.6, "1Mi", 10, interlock={"file": "/allow"}),
            **{f"n{i}": service(0.4, "1Mi", 20 + i) for i in range(2)},
        },
        policies=POLICY,
    )
    robot.request("base", "arm", "n0", "n1")
    robot.wait(lambda: len(robot.active()) == 4)
    robot.sim.locked = {"arm"}
    robot.sim.extra = (0.3, 0)
    later(robot, 20)
    assert robot.active() == {"base", "arm", "n1"}
    assert robot.waits("arm") == ""


def test_an_interlock_that_allows_is_asked_before(robot):
    robot.declare(
        {"base": service(1.5, "1Gi", 90), "arm": service(0.6, "1Mi", 10, interlock={"file": "/allow"})}, policies=POLICY
    )
    robot.request("base", "arm")
    robot.wait(lambda: robot.active() == {"base"})


def test_what_is_not_asked_for_any_more_is_not_shed_any_more(robot):
    robot.declare(
        {"base": service(0.9, "1Gi", 90), "log": service(1.5, "1Gi", 20), "other": service(0.1, "1Mi", 50)},
        policies=POLICY,
    )
    robot.request("base", id="base")
    robot.request("log", id="log")
    robot.wait(lambda: shed(robot) == ["log"])
    robot.release("log")
    robot.wait(lambda: shed(robot) == [])
    robot.wait(lambda: robot.sim.memory.pressure.level == 0)
    robot.request("other", id="other")
    robot.wait(lambda: robot.active() == {"base", "other"})


def test_what_does_not_fit_stays_away_and_keeps_nobody_else_away(robot):
    robot.declare(
        {"base": service(0.9, "1Gi", 90), "log": service(1.5, "1Gi", 20), "other": service(0.1, "1Mi", 10)},
        policies=POLICY,
    )
    robot.request("base", id="base")
    robot.request("log", id="log")
    robot.wait(lambda: shed(robot) == ["log"])
    robot.request("other", id="other")
    robot.wait(lambda: robot.active() == {"base", "other"}, 60)
    later(robot, 300)
    assert robot.active() == {"base", "other"}
    assert "shed under pressure" in robot.waits("log")
    robot.release("base")
    robot.wait(lambda: robot.active() == {"log", "other"})
    robot.wait(lambda: robot.sim.memory.pressure.reason == "")


def test_what_a_protected_service_needs_comes_back_at_once(robot):
    robot.declare(
        {
            "base": service(0.6, "1Gi", 90),
            "camera": service(0.6, "1Gi", 20),
            "arm": service(0.1, "1Mi", 50, protected=True, needs=["camera"]),
        },
        policies=POLICY,
    )
    robot.request("base", id="base")
    robot.request("camera", id="camera")
    robot.wait(lambda: robot.active() == {"base", "camera"})
    robot.sim.extra = (1.0, 0)
    robot.wait(lambda: shed(robot) == ["camera"])
    robot.request("arm", id="arm")
    robot.wait(lambda: robot.active() == {"camera", "arm"}, 20)


def test_a_request_that_matters_more_brings_it_back_in_place_of_others(robot):
    robot.declare(
        {"base": service(0.6, "1Gi", 90), "camera": service(0.6, "1Gi", 20), "log": service(0.3, "1Gi", 80)},
        policies=POLICY,
    )
    robot.request("base", "camera", "log", id="all")
    robot.wait(lambda: len(robot.active()) == 3)
    robot.sim.extra = (0.8, 0)
    robot.wait(lambda: shed(robot) == ["camera"])
    robot.request("camera", id="mission", priority=85)
    robot.wait(lambda: robot.active() == {"base", "camera"}, 20)
    assert "in place of camera" in robot.waits("log")
    changes = len(robot.log())
    later(robot, 300)
    assert len(robot.log()) - changes < 10, "it stays so"
    assert robot.active() == {"base", "camera"}


def test_who_asked_for_it_does_not_go_in_its_place(robot):
    robot.declare(
        {"mission": service(0.6, "1Gi", 30), "camera": service(0.6, "1Gi", 20), "base": service(0.6, "1Gi", 90)},
        policies=POLICY,
    )
    robot.request("mission", "base")
    robot.wait(lambda: len(robot.active()) == 2)
    robot.request("camera", id="look", by="mission", priority=95)
    robot.wait(lambda: len(robot.active()) == 3)
    robot.sim.extra = (0.8, 0)
    robot.wait(lambda: shed(robot) == ["base"])
    later(robot, 60)
    assert robot.active() == {"mission", "camera"}


def test_shares_that_go_up_and_down_often_are_no_failure(robot):
    robot.declare({"drive": service(0.5, "1Gi", 90, protected=True), "log": service(0.5, "1Gi", 20)}, policies=POLICY)
    robot.request("drive", "log")
    robot.wait(lambda: len(robot.active()) == 2)
    for _ in range(6):
        robot.sim.extra = (1.05, 0)
        robot.wait(lambda: robot.container("log").live.get("cpu_shares") == 103, 20)
        robot.sim.extra = (0.5, 0)
        robot.wait(lambda: robot.container("log").live.get("cpu_shares") == 1024, 20)
        assert not robot.sim.memory.of("log").stalled


def test_nothing_is_shed_while_the_engine_cannot_be_asked(crowd):
    crowd.sim.faults.unreachable = True
    crowd.sim.extra = (0.2, 0)
    later(crowd, 100)
    assert shed(crowd) == []
    crowd.sim.faults.unreachable = False
    crowd.wait(lambda: "n0" not in crowd.active(), 10)
    later(crowd, 10)
    assert shed(crowd) == ["n0"]
