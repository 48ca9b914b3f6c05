"""What a robot does, the same on every engine."""

from __future__ import annotations

import pytest

NAVIGATION = {
    "roscore": {},
    "localization": {"needs": ["roscore"]},
    "navigation": {"needs": ["localization"], "idle": {"action": "pause"}},
    "camera": {},
}


@pytest.mark.smoke
def test_nothing_runs_until_it_is_requested(robot):
    robot.declare(NAVIGATION)
    robot.wait(lambda: set(robot.states().values()) == {"created"} and len(robot.states()) == 4)
    robot.settle()
    assert robot.active() == set()


@pytest.mark.smoke
def test_a_request_starts_what_is_needed_first_and_its_release_ceases_it(robot):
    robot.declare(NAVIGATION)
    robot.settle()
    robot.request("navigation")
    robot.wait(lambda: robot.active() == {"roscore", "localization", "navigation"})
    robot.settle()
    starts = [line.split()[2] for line in robot.log() if line.startswith("> start")]
    assert starts == ["roscore", "localization", "navigation"]
    robot.release()
    robot.wait(lambda: not robot.active())
    robot.settle()
    assert robot.states() == {
        "roscore": "exited",
        "localization": "exited",
        "navigation": "paused" if robot.can("pause") else "exited",
        "camera": "created",
    }
    robot.request("navigation")
    robot.wait(lambda: "navigation" in robot.active())
    robot.settle()
    resumed = any(line.startswith("= resume navigation") for line in robot.log())
    assert resumed is robot.can("pause")


@pytest.mark.smoke
def test_idle_remove_leaves_no_container(robot):
    robot.declare({"camera": {"idle": {"action": "remove"}}})
    robot.settle()
    assert robot.states() == {}
    robot.request("camera")
    robot.wait(lambda: robot.active() == {"camera"})
    robot.release()
    robot.wait(lambda: robot.states() == {})


def test_always_on_services_run_without_a_request(robot):
    robot.declare({"base": {"always_on": True}, "logger": {"always_on": True, "needs": ["base"]}})
    robot.wait(lambda: robot.active() == {"base", "logger"})


def test_a_group_stands_for_its_members(robot):
    robot.declare(NAVIGATION, groups={"driving": {"services": ["navigation", "camera"]}})
    robot.settle()
    robot.request("driving")
    robot.wait(lambda: robot.active() == set(NAVIGATION))


@pytest.mark.smoke
def test_a_crash_is_repaired_at_once(robot):
    robot.declare({"camera": {"always_on": True}})
    robot.wait(lambda: robot.active() == {"camera"})
    robot.settle()
    before = robot.container("camera")
    robot.kill("camera")
    robot.wait(lambda: robot.active() == {"camera"} and robot.container("camera").incarnation != before.incarnation)
    assert robot.container("camera").id == before.id


@pytest.mark.smoke
def test_a_stop_behind_its_back_is_undone(robot):
    robot.declare({"camera": {"always_on": True}})
    robot.wait(lambda: robot.active() == {"camera"})
    robot.settle()
    before = robot.container("camera")
    robot.drift("stop", "camera", "SIGTERM", 5.0)
    robot.wait(lambda: robot.active() == {"camera"} and robot.container("camera").incarnation != before.incarnation)
    assert robot.container("camera").id == before.id


@pytest.mark.smoke
def test_a_pause_behind_its_back_is_undone(robot):
    robot.declare({"camera": {"always_on": True}})
    robot.wait(lambda: robot.active() == {"camera"})
    robot.settle()
    if not robot.can("pause"):
        pytest.skip("nobody can pause on this engine: see docs/reference/engines.md")
    robot.drift("pause", "camera")
    robot.wait(lambda: robot.active() == {"camera"})


def test_a_rename_behind_its_back_is_undone(robot):
    robot.declare({"camera": {"always_on": True}})
    robot.wait(lambda: robot.active() == {"camera"})
    robot.settle()
    before = robot.container("camera").id
    robot.drift("rename", "camera", "elsewhere")
    robot.wait(lambda: robot.container("camera").name == "camera")
    assert robot.container("camera").id == before


@pytest.mark.slow
def test_requests_end_with_the_run_of_their_requester(robot):
    robot.declare({"behaviour": {}, "camera": {}})
    robot.settle()
    robot.request("behaviour")
    robot.wait(lambda: robot.active() == {"behaviour"})
    robot.request("camera", id="look", by="behaviour")
    robot.wait(lambda: robot.active() == {"behaviour", "camera"})
    robot.settle()
    robot.drift("stop", "behaviour", "SIGTERM", 5.0)
    robot.wait(lambda: robot.active() == {"behaviour"})
    assert [r.id for r in robot.requests()] == ["test"]
    assert any("look" in line and "dropped" in line for line in robot.log())


def test_requests_sleep_while_their_requester_is_not_wanted_and_come_back_with_it(robot):
    robot.declare({"behaviour": {"idle": {"action": "pause"}}, "camera": {}})
    robot.settle()
    robot.request("behaviour")
    robot.wait(lambda: robot.active() == {"behaviour"})
    robot.request("camera", id="look", by="behaviour")
    robot.wait(lambda: robot.active() == {"behaviour", "camera"})
    robot.settle()
    robot.release()
    robot.wait(lambda: robot.active() == set() and robot.states()["behaviour"] in ("paused", "exited"))
    robot.settle()
    robot.request("behaviour")
    robot.wait(lambda: robot.active() == ({"behaviour", "camera"} if robot.can("pause") else {"behaviour"}))


@pytest.mark.slow
@pytest.mark.smoke
def test_a_change_replaces_exactly_one_container(robot):
    robot.declare({"aa": {"always_on": True}, "bb": {"always_on": True}})
    robot.wait(lambda: robot.active() == {"aa", "bb"})
    robot.settle()
    before = {c.service: c.id for c in robot.containers()}
    robot.declare({"aa": {"always_on": True, "container": {"environment": {"SPEED": "2"}}}, "bb": {"always_on": True}})
    robot.wait(
        lambda: (
            robot.active() == {"aa", "bb"} and robot.container("aa").id != before["aa"] and len(robot.containers()) == 2
        )
    )
    robot.settle()
    assert robot.container("bb").id == before["bb"]
    assert robot.container("aa").name == "aa"


def test_a_live_option_changes_without_a_new_container(robot):
    robot.declare({"aa": {"always_on": True, "container": {"cpu_shares": 512}}})
    robot.wait(lambda: robot.active() == {"aa"})
    robot.settle()
    if not robot.can("update"):
        pytest.skip("this engine changes nothing in place: see docs/reference/engines.md")
    before = robot.container("aa").incarnation
    robot.declare({"aa": {"always_on": True, "container": {"cpu_shares": 256}}})
    robot.wait(lambda: robot.container("aa").live["cpu_shares"] == 256)
    robot.settle()
    assert robot.container("aa").incarnation == before
    robot.declare({"aa": {"always_on": True, "container": {"cpu_shares": 512}}})
    robot.wait(lambda: robot.container("aa").live["cpu_shares"] == 512)
    assert robot.container("aa").incarnation == before


def test_a_live_option_that_is_taken_back_costs_a_new_container(robot):
    """Engines take 0 for "not said": there is no way back in place."""
    robot.declare({"aa": {"always_on": True, "container": {"cpu_shares": 512}}})
    robot.wait(lambda: robot.active() == {"aa"})
    robot.settle()
    before = robot.container("aa").id
    robot.declare({"aa": {"always_on": True}})
    robot.wait(lambda: robot.container("aa").id != before and robot.states() == {"aa": "running"})
    assert robot.container("aa").live.get("cpu_shares", 0) == 0


def test_an_undeclared_service_is_stopped_and_removed(robot):
    robot.declare({"aa": {"always_on": True}, "bb": {"always_on": True}})
    robot.wait(lambda: robot.active() == {"aa", "bb"})
    robot.settle()
    robot.declare({"aa": {"always_on": True}})
    robot.wait(lambda: robot.states() == {"aa": "running"})


def test_what_only_requests_itself_in_a_ring_is_ceased(robot):
    robot.declare(
        {"aa": {}, "bb": {}},
        requests={"one": {"requester": "aa", "services": ["bb"]}, "two": {"requester": "bb", "services": ["aa"]}},
    )
    robot.settle()
    robot.request("aa")
    robot.wait(lambda: robot.active() == {"aa", "bb"})
    robot.release()
    robot.wait(lambda: robot.active() == set())


def test_a_lingering_service_stays_for_its_time(robot):
    robot.declare({"camera": {"idle": {"action": "stop", "linger": "500ms"}}})
    robot.settle()
    robot.request("camera")
    robot.wait(lambda: robot.active() == {"camera"})
    before = robot.container("camera").incarnation
    robot.release()
    robot.request("camera")
    robot.settle()
    assert robot.container("camera").incarnation == before
    robot.release()
    robot.wait(lambda: robot.active() == set())
