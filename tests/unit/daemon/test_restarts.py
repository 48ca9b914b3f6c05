"""Restarts: done once for each time that they are asked for, spread only from a need that was restarted. Odd states."""

from __future__ import annotations

from dataclasses import replace

import pytest
from robots import VirtualRobot, handed_on
from virtual_time import later

from rorg.core.memory import Memory
from rorg.core.operations import Stop
from rorg.model.units import stamp
from rorg.store.requests_document import RequestsDocument
from rorg.store.requests_parser import parse, render
from rorg.tools.sim.calls import UNSUPPORTED

RESTART = {"needs": [{"service": "tf", "restart": True}]}


@pytest.fixture
def robot(tmp_path):
    return VirtualRobot(tmp_path)


def ask(robot, name: str, ahead: float = 0.0) -> None:
    robot.change(lambda document: replace(document, restarts={**document.restarts, name: stamp(robot.wall() + ahead)}))


def starts(robot, name: str) -> int:
    return sum(line.startswith(f"> start {name} ") for line in robot.log())


def test_a_restart_is_done_once_and_then_forgotten(robot):
    robot.declare({"arm": {"always_on": True}})
    robot.settle()
    later(robot, 5)
    ask(robot, "arm")
    robot.wait(lambda: starts(robot, "arm") == 2)
    later(robot, 10)
    assert starts(robot, "arm") == 2
    assert robot.sim.document.restarts == {}


def test_a_restart_dated_ahead_waits_for_its_time_and_is_done_once(robot):
    robot.declare({"arm": {"always_on": True}})
    robot.settle()
    ask(robot, "arm", 60.0)
    later(robot, 50)
    assert starts(robot, "arm") == 1
    later(robot, 60)
    assert starts(robot, "arm") == 2


@pytest.mark.parametrize("seconds", [-3600.0, 3600.0])
def test_a_clock_that_is_set_restarts_nothing_twice_and_forgets_no_restart(robot, seconds):
    robot.declare({"arm": {"always_on": True}})
    robot.settle()
    later(robot, 5)
    robot.sim.clock_set = seconds
    ask(robot, "arm")
    robot.wait(lambda: starts(robot, "arm") == 2)
    later(robot, 30)
    assert starts(robot, "arm") == 2
    assert robot.sim.document.restarts == {}


def test_an_engine_whose_clock_is_behind_restarts_once(robot):
    robot.declare({"arm": {"always_on": True}})
    robot.settle()
    later(robot, 5)
    engine, clock = robot.sim.engine, robot.sim.engine.clock
    engine.wall = lambda: clock() - 3600
    ask(robot, "arm")
    robot.wait(lambda: starts(robot, "arm") == 2)
    later(robot, 30)
    assert starts(robot, "arm") == 2


@pytest.mark.parametrize("when", ["between the starts", "while both run"])
def test_a_clock_set_back_is_no_restart_of_a_need(robot, when):
    robot.declare({"arm": {"always_on": True, **RESTART}, "tf": {}})
    if when == "between the starts":
        robot.wait(lambda: starts(robot, "tf") == 1)
    else:
        robot.settle()
        later(robot, 100)
    robot.sim.clock_set = -600.0
    later(robot, 30)
    before = starts(robot, "arm")
    robot.kill("arm")
    later(robot, 60)
    assert starts(robot, "arm") == before + 1


def test_a_clock_set_back_to_before_the_boot_hides_no_exit(robot):
    robot.declare({"job": {"restart": "never"}})
    robot.sim.clock_set = -600.0
    robot.sim.faults.crash_after["job"], robot.sim.faults.exit_code = 2.0, 0
    robot.request("job")
    later(robot, 60)
    assert starts(robot, "job") == 1


@pytest.mark.parametrize("code", [1, 137], ids=["ended", "killed, and nothing is remembered"])
def test_what_ended_with_the_machine_is_started_without_delay(robot, code):
    robot.declare({"arm": {"always_on": True}})
    robot.settle()
    robot.sim.engine.kill(robot.container("arm").id, code)
    robot.sim.reborn(handed_on(robot.sim.decision, rebooted=True) if code == 1 else Memory())
    robot.wait(lambda: robot.active() == {"arm"}, 1)
    assert robot.sim.memory.of("arm").crashes == 0


def test_a_job_that_is_done_runs_again_when_its_restart_is_asked_for(robot):
    robot.declare({"job": {"restart": "on-failure"}})
    robot.sim.faults.crash_after["job"], robot.sim.faults.exit_code = 1.0, 0
    robot.request("job")
    later(robot, 10)
    assert starts(robot, "job") == 1
    ask(robot, "job")
    later(robot, 10)
    assert starts(robot, "job") == 2
    assert robot.sim.document.restarts == {}


def test_a_crash_loop_keeps_its_pauses_whatever_else_fails(robot):
    robot.declare({"cam": {"always_on": True, "container": {"cpu_shares": 512}}})
    robot.settle()
    robot.sim.faults.fail["update", "cam"] = ["no such cgroup"] * 1000
    robot.declare({"cam": {"always_on": True, "container": {"cpu_shares": 256}}})
    later(robot, 5)
    robot.sim.faults.crash_after["cam"] = 0.5
    robot.kill("cam")
    later(robot, 120)
    assert starts(robot, "cam") < 12


def test_a_failure_that_nobody_needs_to_repeat_any_more_is_forgotten(robot):
    robot.declare({"cam": {"always_on": True, "container": {"cpu_shares": 512}}})
    robot.settle()
    robot.sim.faults.fail["update", "cam"] = ["no such cgroup"] * 5
    robot.declare({"cam": {"always_on": True, "container": {"cpu_shares": 256}}})
    robot.wait(lambda: robot.sim.memory.of("cam").stalled)
    robot.declare({"cam": {"always_on": True, "container": {"cpu_shares": 512}}})
    robot.settle()
    robot.sim.step()
    assert not robot.sim.memory.of("cam").stalled
    assert robot.sim.memory.of("cam").error == ""


def test_an_option_that_may_not_be_set_now_blocks_nobody_else(robot):
    arm = {"always_on": True, "interlock": {"file": "/allow"}, "container": {"cpu_shares": 512}}
    robot.declare({"arm": arm, "monitor": {"needs": ["arm"]}})
    robot.settle()
    robot.sim.locked = {"arm"}
    robot.declare({"arm": {**arm, "container": {"cpu_shares": 256}}, "monitor": {"needs": ["arm"]}})
    robot.request("monitor")
    robot.wait(lambda: robot.active() == {"arm", "monitor"}, 5)
    assert robot.waits("arm") == "interlock: not allowed"


def test_requests_of_a_service_turned_into_a_meta_service_end_with_its_container(robot):
    robot.declare({"mission": {"always_on": True}, "cam": {}})
    robot.settle()
    robot.request("cam", id="look", by="mission")
    robot.wait(lambda: "cam" in robot.active())
    robot.declare({"mission": {"type": "meta"}, "cam": {}})
    robot.wait(lambda: robot.active() == set())
    assert robot.requests() == ()


@pytest.mark.parametrize("value", ["soon", "2026-13-01", "{}", "[1]"])
def test_a_restart_at_no_time_is_an_error(value):
    document, diagnostics = parse(f"restarts: {{arm: {value}}}\n", "requests.yaml")
    assert document is None
    assert "is not a time" in str(diagnostics[0])


def test_times_are_read_in_any_zone_and_written_in_one():
    document, _ = parse("restarts: {arm: 2026-01-31T13:00:00+01:00, leg: '2026-01-31T12:00:00Z'}\n", "requests.yaml")
    assert set(document.restarts.values()) == {"2026-01-31T12:00:00.000000Z"}
    again, _ = parse(render(document), "requests.yaml")
    assert again == replace(RequestsDocument(), restarts=document.restarts)


@pytest.mark.parametrize("order", ["need first", "need later", "need new"])
def test_a_need_that_is_added_restarts_nobody(robot, order):
    tree = {"arm": {"always_on": True}, "tf": {"always_on": order != "need new"}}
    robot.declare({**tree, "arm": {}} if order == "need first" else {**tree, "tf": {}})
    robot.settle()
    robot.declare(tree)
    robot.settle()
    before = robot.container("arm").incarnation
    robot.declare({**tree, "arm": {"always_on": True, **RESTART}})
    later(robot, 10)
    assert robot.active() == {"arm", "tf"}
    assert robot.container("arm").incarnation == before
    robot.kill("tf")
    robot.wait(lambda: robot.container("arm").incarnation != before and robot.active() == {"arm", "tf"})


def test_following_a_need_that_is_there_already_restarts_nobody(robot):
    tree = {"arm": {"always_on": True, "needs": ["tf"]}, "tf": {}}
    robot.declare(tree)
    robot.settle()
    before = robot.container("arm").incarnation
    robot.kill("tf")
    robot.settle()
    robot.declare({**tree, "arm": {"always_on": True, **RESTART}})
    later(robot, 10)
    assert robot.container("arm").incarnation == before


def test_a_service_turned_into_a_meta_service_loses_its_container_and_nobody_else(robot):
    robot.declare({"aa": {"always_on": True}, "bb": {"always_on": True}})
    robot.settle()
    robot.declare({"aa": {"type": "meta"}, "bb": {"always_on": True}})
    robot.settle()
    assert robot.states() == {"bb": "running"}


def test_an_interlock_outlives_its_manifest(robot):
    arm = {"always_on": True, "interlock": {"file": "/allow"}, "container": {"stop_signal": "SIGINT"}}
    robot.declare({"arm": arm, "cam": {"always_on": True}})
    robot.settle()
    robot.sim.locked = {"arm"}
    robot.declare({"cam": {"always_on": True}})
    later(robot, 10)
    assert robot.active() == {"arm", "cam"}
    assert "interlock" in robot.waits("arm")
    robot.sim.locked = set()
    robot.wait(lambda: robot.active() == {"cam"})


def test_what_no_manifest_declares_any_more_is_stopped_as_it_was_declared(robot):
    robot.declare({"arm": {"always_on": True, "container": {"stop_signal": "SIGINT", "stop_grace_period": "7s"}}})
    robot.settle()
    robot.declare({"cam": {}})
    stop = next(a.operation for a in robot.sim.step().plan.actions if isinstance(a.operation, Stop))
    assert (stop.signal, stop.grace) == ("SIGINT", 7.0)


@pytest.mark.parametrize("declared", [True, False])
def test_nothing_waits_for_a_container_that_the_engine_is_removing(robot, declared):
    robot.declare({"aa": {"idle": {"action": "remove"}}, "bb": {"always_on": True}})
    robot.request("aa")
    robot.wait(lambda: robot.active() == {"aa", "bb"})
    removing = robot.container("aa")
    robot.sim.engine.containers[removing.id] = replace(removing, state="removing")
    if not declared:
        robot.release()
        robot.declare({"bb": {"always_on": True}})
    later(robot, 5)
    assert robot.active() == ({"aa", "bb"} if declared else {"bb"})
    del robot.sim.engine.containers[removing.id]
    robot.settle()
    assert robot.states().keys() == ({"aa", "bb"} if declared else {"bb"})


def test_what_was_removed_at_the_end_of_its_idling_is_not_made_again(robot):
    robot.declare({"cam": {"idle": {"action": "pause", "escalate": {"after": "3s", "action": "remove"}}}})
    for _ in range(2):
        robot.request("cam")
        robot.wait(lambda: robot.active() == {"cam"})
        robot.release()
        robot.wait(lambda: robot.states() == {})
        later(robot, 20)
    assert sum(line.startswith("+ create") for line in robot.log()) <= 3
    robot.request("cam")
    robot.wait(lambda: robot.active() == {"cam"})


def test_an_option_that_the_engine_refuses_holds_nothing_else_back(robot):
    spec = {"idle": {"action": "pause"}, "container": {"cpu_shares": 512}}
    robot.declare({"cam": spec})
    robot.request("cam")
    robot.wait(lambda: robot.active() == {"cam"})
    robot.sim.faults.fail["update", "cam"] = ["no such cgroup"] * 1000
    robot.declare({"cam": {**spec, "container": {"cpu_shares": 256}}})
    robot.wait(lambda: "no such cgroup" in robot.waits("cam"))
    robot.release()
    robot.wait(lambda: robot.states()["cam"] == "paused", 5)
    robot.request("cam")
    robot.wait(lambda: robot.active() == {"cam"}, 5)
    ask(robot, "cam")
    robot.wait(lambda: starts(robot, "cam") == 2, 5)


def test_two_services_swap_their_names(robot):
    names = {"aa": "left", "bb": "right"}
    robot.declare({n: {"always_on": True, "container": {"container_name": c}} for n, c in names.items()})
    robot.settle()
    before = {c.service: c.incarnation for c in robot.containers()}
    names = {"aa": "right", "bb": "left"}
    robot.declare({n: {"always_on": True, "container": {"container_name": c}} for n, c in names.items()})
    robot.settle()
    assert {c.service: c.name for c in robot.containers()} == names
    assert {c.service: c.incarnation for c in robot.containers()} == before


@pytest.mark.parametrize("name", ["top", "all"])
def test_a_new_request_tries_all_again_that_it_needs(robot, name):
    """Also what is always on, however far behind: it was stalled before anybody asked."""
    robot.declare(
        {
            "base": {"always_on": True},
            "middle": {"needs": ["base"], "always_on": True},
            "near": {"needs": ["middle"]},
            "top": {"needs": ["near"]},
            "other": {"always_on": True},
        },
        groups={"all": {"services": ["top"]}},
    )
    for stalling in ("base", "other"):
        robot.sim.faults.crash_after[stalling] = 0.5
    robot.wait(lambda: all(robot.sim.memory.of(n).retry_at > robot.now() + 5 for n in ("base", "other")), 600)
    begun = robot.container("other").started_at
    robot.sim.faults.crash_after.clear()
    at = robot.now()
    robot.request(name)
    robot.wait(lambda: {"base", "middle", "near", "top"} <= robot.active())
    assert robot.now() - at < 3
    assert not robot.sim.memory.of("base").stalled
    assert robot.container("other").started_at == begun, "nobody asked for it"


def test_the_same_request_again_does_not_hurry_what_crashes(robot):
    robot.declare({"base": {"always_on": True}, "top": {"needs": ["base"]}})
    robot.request("top")
    robot.sim.faults.crash_after["base"] = 0.5
    robot.wait(lambda: robot.sim.memory.of("base").stalled)
    due = robot.sim.memory.of("base").retry_at
    robot.request("top")
    robot.wait(lambda: robot.now() >= due - 1)
    assert robot.sim.memory.of("base").stalled
    assert robot.sim.memory.of("base").retry_at == due


@pytest.mark.parametrize(("why", "attempts"), [(UNSUPPORTED, 1), ("unable to freeze", 2)])
def test_what_cannot_be_paused_is_stopped_and_that_is_said(robot, why, attempts):
    robot.declare({"cam": {"idle": {"action": "pause", "linger": 0, "escalate": {"after": "60s", "action": "remove"}}}})
    robot.request("cam")
    robot.wait(lambda: robot.active() == {"cam"})
    robot.sim.faults.fail["pause", "cam"] = [why] * 1000
    robot.release()
    robot.wait(lambda: robot.states()["cam"] == "exited", 30)
    assert 1000 - len(robot.sim.faults.fail["pause", "cam"]) == attempts
    assert [line for line in robot.log() if f"stop instead of pause: {why}" in line]
    robot.request("cam")
    robot.wait(lambda: robot.active() == {"cam"}, 30)
    robot.release()
    robot.wait(lambda: not robot.containers(), 600)
