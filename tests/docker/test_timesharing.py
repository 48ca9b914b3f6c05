"""Requests with an end, idling in steps, holds, exclusive resources, restarts that spread: the same on every engine."""

from __future__ import annotations

import pytest

POLICY = {"policy": {"budget": {"cpu": 1.0, "over": "queue"}}}


def active(robot, *names):
    robot.wait(lambda: robot.active() == set(names))


def test_a_lease_that_is_not_renewed_runs_out(robot):
    robot.declare({"camera": {}})
    robot.settle()
    robot.request("camera", ttl=1.0)
    active(robot, "camera")
    active(robot)
    assert robot.requests() == ()
    assert any("lease of 1 s ran out" in line for line in robot.log())


@pytest.mark.slow
def test_a_lease_that_is_renewed_goes_on(robot):
    robot.declare({"camera": {}, "lidar": {}})
    robot.settle()
    robot.request("camera", ttl=4.0)
    active(robot, "camera")
    for n in range(3):
        # Another service with a lease of its own tells the time.
        robot.request("camera", ttl=4.0, renewed=f"{n}")
        robot.request("lidar", id="clock", ttl=1.5)
        robot.wait(lambda: "lidar" in robot.active())
        robot.wait(lambda: "lidar" not in robot.active())
    assert "camera" in robot.active()
    active(robot)


@pytest.mark.slow
def test_no_lease_runs_out_while_its_owner_is_paused(robot):
    robot.declare({"behaviour": {"idle": {"action": "pause"}}, "camera": {}, "lidar": {}})
    robot.settle()
    robot.request("behaviour")
    active(robot, "behaviour")
    robot.request("camera", id="look", by="behaviour", ttl=4.0)
    active(robot, "behaviour", "camera")
    robot.release()
    robot.wait(lambda: robot.states()["behaviour"] == "paused")
    robot.request("lidar", id="clock", ttl=4.5)
    robot.wait(lambda: "lidar" in robot.active())
    robot.wait(lambda: "lidar" not in robot.active())
    robot.request("behaviour")
    active(robot, "behaviour", "camera")


def test_a_service_stays_active_for_its_least_time(robot):
    robot.declare({"camera": {"idle": {"min_active": "1s"}}})
    robot.settle()
    robot.request("camera")
    active(robot, "camera")
    robot.release()
    robot.wait(lambda: "lingers" in robot.waits("camera"))
    assert "camera" in robot.active()
    active(robot)


def test_a_paused_service_is_stopped_after_a_while(robot):
    robot.declare({"camera": {"idle": {"action": "pause", "escalate": {"after": "500ms", "action": "stop"}}}})
    robot.settle()
    robot.request("camera")
    active(robot, "camera")
    robot.release()
    robot.wait(lambda: robot.states()["camera"] == "paused")
    robot.wait(lambda: robot.states()["camera"] == "exited")
    robot.wait(lambda: any("# stop camera (not wanted for" in line for line in robot.log()))


@pytest.mark.slow
def test_a_held_service_is_ceased_though_requested_and_its_dependants_wait_with_the_reason(robot):
    robot.declare({"roscore": {}, "localization": {"needs": ["roscore"]}, "navigation": {"needs": ["localization"]}})
    robot.settle()
    robot.request("navigation")
    active(robot, "roscore", "localization", "navigation")
    robot.hold("localization", 15.0, "calibration")
    robot.wait(lambda: not {"localization", "navigation"} & robot.active())
    robot.wait(
        lambda: (
            robot.waits("navigation").startswith("localization held until")
            and "calibration" in robot.waits("navigation")
        )
    )
    active(robot, "roscore", "localization", "navigation")


@pytest.mark.slow
def test_while_suspended_nothing_changes_and_drift_is_shown(robot):
    robot.declare({"camera": {}})
    robot.settle()
    robot.suspend(4.0, "maintenance")
    robot.request("camera")
    robot.wait(lambda: "maintenance" in robot.waits("rorg"))
    assert robot.active() == set()
    active(robot, "camera")


def test_an_exclusive_resource_goes_to_the_higher_priority_and_the_loser_waits(robot):
    robot.declare(
        {"train": {"exclusive": ["gpu"], "priority": 10}, "detect": {"exclusive": {"gpu": 1}, "priority": 80}}
    )
    robot.settle()
    robot.request("train", id="train")
    active(robot, "train")
    robot.request("detect", id="detect")
    active(robot, "detect")
    robot.wait(lambda: "waits for gpu, which is taken by detect" in robot.waits("train"))
    robot.release("detect")
    active(robot, "train")


def test_a_paused_holder_lets_go_of_an_exclusive_resource(robot):
    robot.declare({"old": {"exclusive": ["camera0"], "idle": {"action": "pause"}}, "new": {"exclusive": ["camera0"]}})
    robot.settle()
    robot.request("old")
    active(robot, "old")
    robot.release()
    robot.wait(lambda: robot.states()["old"] == "paused")
    robot.request("new")
    active(robot, "new")
    assert robot.states()["old"] == "exited"


def test_two_fit_where_the_policy_says_that_there_are_two(robot):
    robot.declare(
        {n: {"exclusive": ["gpu"]} for n in ("aa", "bb", "cc")}, policies={"policy": {"resources": {"gpu": 2}}}
    )
    robot.settle()
    robot.request("aa", "bb", "cc")
    active(robot, "aa", "bb")
    robot.wait(lambda: "gpu" in robot.waits("cc"))


def test_a_request_that_does_not_fit_is_queued_and_served_when_there_is_room(robot):
    robot.declare({n: {"resources": {"cpu": 0.6}} for n in ("aa", "bb")}, policies=POLICY)
    robot.settle()
    robot.request("aa", id="first")
    active(robot, "aa")
    robot.request("bb", id="second")
    robot.wait(lambda: "1.2 cores would exceed the budget of 1" in robot.waits("bb"))
    assert robot.active() == {"aa"}
    robot.release("first")
    active(robot, "bb")


def test_the_restart_of_a_need_restarts_who_asked_for_that_and_nobody_else(robot):
    robot.declare(
        {
            "roscore": {},
            "driver": {"needs": [{"service": "roscore", "restart": True}]},
            "planner": {"needs": [{"service": "roscore", "restart": True}, "driver"]},
            "logger": {"needs": ["roscore"]},
        }
    )
    robot.settle()
    robot.request("planner", "logger")
    active(robot, "roscore", "driver", "planner", "logger")
    robot.settle()
    before = {c.service: c.incarnation for c in robot.containers()}
    robot.kill("roscore")
    robot.wait(
        lambda: (
            len(robot.active()) == 4
            and all(robot.container(n).incarnation != before[n] for n in ("roscore", "driver", "planner"))
        )
    )
    robot.settle()
    assert robot.container("logger").incarnation == before["logger"]
    started = {n: robot.container(n).started_at for n in before}
    assert started["roscore"] < started["driver"] < started["planner"]


def test_a_paused_service_whose_need_was_restarted_is_not_resumed_but_started_anew(robot):
    robot.declare(
        {
            "roscore": {"always_on": True},
            "driver": {"needs": [{"service": "roscore", "restart": True}], "idle": {"action": "pause"}},
        }
    )
    robot.request("driver")
    active(robot, "roscore", "driver")
    robot.release()
    robot.wait(lambda: robot.states()["driver"] == "paused")
    before, needed = robot.container("driver").incarnation, robot.container("roscore").incarnation
    robot.kill("roscore")
    robot.wait(lambda: robot.container("roscore").incarnation != needed)
    active(robot, "roscore")
    robot.settle()
    robot.request("driver")
    robot.wait(lambda: "driver" in robot.active() and robot.container("driver").incarnation != before)
    assert not any("= resume driver" in line for line in robot.log())


def test_a_freeze_that_fails_is_tried_again(tmp_path):
    from robots import VirtualRobot

    robot = VirtualRobot(tmp_path)
    robot.declare({"camera": {"idle": {"action": "pause"}}})
    robot.request("camera")
    active(robot, "camera")
    robot.sim.faults.fail["pause", "camera"] = ["unable to freeze"]
    robot.release()
    robot.wait(lambda: robot.states()["camera"] == "paused")
    assert sum("unable to freeze" in line for line in robot.log()) == 1


def test_requests_of_a_replaced_or_removed_owner_are_dropped(robot):
    tree = {"behaviour": {}, "camera": {}}
    robot.declare(tree)
    robot.settle()
    robot.request("behaviour")
    active(robot, "behaviour")
    robot.request("camera", id="look", by="behaviour")
    active(robot, "behaviour", "camera")
    robot.declare({**tree, "behaviour": {"container": {"environment": {"SPEED": "2"}}}})
    active(robot, "behaviour")
    assert [r.id for r in robot.requests()] == ["test"]
    robot.request("camera", id="look", by="behaviour")
    active(robot, "behaviour", "camera")
    robot.release()
    robot.declare({"camera": {}})
    active(robot)
    robot.wait(lambda: not robot.requests())


def test_put_and_release_can_be_said_twice(robot):
    robot.declare({"camera": {}, "lidar": {}})
    robot.settle()
    for _ in range(2):
        robot.request("camera")
    robot.request("lidar")
    active(robot, "lidar")
    assert len(robot.requests()) == 1
    for _ in range(2):
        robot.release()
    active(robot)


def test_a_job_that_has_ended_runs_again_when_it_is_requested_again(robot):
    """`restart: never` leaves one request's run at its end; the next request is another matter."""
    robot.declare({"job": {"restart": "never"}})
    robot.settle()
    for _ in range(2):
        robot.request("job")
        active(robot, "job")
        robot.kill("job")
        robot.wait(lambda: robot.states()["job"] == "exited")
        robot.release()
        robot.settle()
