"""What requests lose, with the cause that clients act on, and changes of state as the journal tells them."""

from __future__ import annotations

from dataclasses import replace

import pytest
from robots import VirtualRobot

from rorg.core.decide import Decision
from rorg.core.links import Remote
from rorg.core.peers import Peers
from rorg.core.service_events import NONE, READY, Loss, StateChange, losses, ready_runs, state_changes, state_of
from rorg.model.units import stamp

HARD = {"ready": {"tcp": 1234}, "live": {"tcp": 1234}}


@pytest.fixture
def robot(tmp_path):
    return VirtualRobot(tmp_path)


def begin(robot: VirtualRobot, specs: dict, *services: str, **kinds: dict) -> dict[str, str]:
    """Requests services, and returns the runs that requests then rely on."""
    robot.declare(specs, **kinds)
    robot.request(*services)
    robot.wait(lambda: {*services} <= ready_runs(robot.sim.decision).keys())
    robot.settle()
    return ready_runs(robot.sim.decision)


def lost(robot: VirtualRobot, before: dict[str, str]) -> list[Loss]:
    """What is lost in the first pass in which something is."""
    found: list[Loss] = []
    robot.wait(lambda: found.extend(losses(before, ready_runs(robot.sim.decision), robot.sim.decision)) or found)
    return found


def causes(robot: VirtualRobot, before: dict[str, str]) -> dict[str, tuple[str, str]]:
    return {one.service: (one.cause, one.reason) for one in lost(robot, before)}


def test_nothing_is_lost_while_all_goes_well(robot):
    before = begin(robot, {"base": {}, "arm": {"needs": ["base"]}}, "arm")
    assert before == {name: robot.run_of(name) for name in ("base", "arm")}
    assert losses(before, before, robot.sim.decision) == []


def test_a_crash_names_the_run_and_the_requests(robot):
    before = begin(robot, {"base": {}, "arm": {"needs": ["base"]}, "lamp": {"always_on": True}}, "arm")
    robot.kill("base")
    (one,) = lost(robot, before)
    assert (one.service, one.cause, one.incarnation) == ("base", "crashed", before["base"])
    assert one.reason == "ended with exit code 137"
    assert one.requests == ("developer/test",)


def test_what_runs_on_because_its_next_container_cannot_be_made_is_no_loss(robot):
    before = begin(robot, {"base": {}}, "base")
    robot.sim.faults.fail["create", "base"] = ["no space left on the device"] * 3
    robot.declare({"base": {"command": ["another"]}})
    robot.wait(lambda: "no space left" in robot.waits("base"))
    seen: list[Loss] = []

    def told() -> bool:
        seen.extend(losses(before, ready_runs(robot.sim.decision), robot.sim.decision))
        return not robot.sim.faults.fail["create", "base"]

    robot.wait(told)
    assert seen == []
    assert lost(robot, before)[0].cause == "replaced"


def test_what_no_request_uses_is_no_loss(robot):
    before = begin(robot, {"base": {}, "lamp": {"always_on": True}}, "base")
    robot.kill("lamp")
    robot.wait(lambda: "lamp" not in ready_runs(robot.sim.decision))
    assert losses(before, ready_runs(robot.sim.decision), robot.sim.decision) == []


def test_a_hold_is_the_cause_also_for_what_needs_it(robot):
    before = begin(robot, {"base": {}, "arm": {"needs": ["base"]}}, "arm")
    robot.hold("base", 60, "cleaning")
    assert {name: cause for name, (cause, _) in causes(robot, before).items()} == {"arm": "held", "base": "held"}


def test_a_rival_with_priority_is_the_cause(robot):
    specs = {"arm": {"exclusive": ["gpu"]}, "drive": {"exclusive": ["gpu"], "priority": 90}}
    before = begin(robot, specs, "arm")
    robot.request("drive", id="other")
    assert causes(robot, before)["arm"][0] == "preempted"


def test_a_change_and_a_restart_are_told_apart(robot):
    before = begin(robot, {"base": {}, "arm": {}}, "base", "arm")
    robot.declare({"base": {}, "arm": {"container": {"environment": {"N": "1"}}}})
    assert causes(robot, before)["arm"][0] == "replaced"


def test_a_restart_that_was_asked_for(robot):
    before = begin(robot, {"base": {}}, "base")
    robot.change(lambda asked: replace(asked, restarts={"base": stamp(robot.wall())}))
    assert causes(robot, before)["base"][0] == "restarted"


def test_a_need_that_restarts_takes_along_what_restarts_with_it(robot):
    specs = {"base": {}, "scan": {"needs": [{"service": "base", "restart": True}]}}
    before = begin(robot, specs, "scan")
    robot.kill("base")
    robot.wait(lambda: robot.sim.decision.memory.of("base").crashes)
    robot.wait(lambda: "scan" not in ready_runs(robot.sim.decision))
    found = {
        one.service: one.cause
        for one in losses({"scan": before["scan"]}, ready_runs(robot.sim.decision), robot.sim.decision)
    }
    assert found == {"scan": "restarted"}


def test_what_does_not_answer_hangs(robot):
    before = begin(robot, {"base": HARD}, "base")
    robot.sim.hung.add(robot.run_of("base"))
    assert causes(robot, before)["base"][0] == "hung"


def test_a_requester_that_is_not_wanted_loses_nothing(robot):
    specs = {"mission": {"may_request": ["arm"]}, "arm": {}}
    robot.declare(specs)
    robot.request("mission")
    robot.wait(lambda: "mission" in robot.active())
    robot.request("arm", id="own", by="mission")
    robot.wait(lambda: "arm" in ready_runs(robot.sim.decision))
    before = ready_runs(robot.sim.decision)
    robot.kill("arm")
    (one,) = lost(robot, before)
    assert one.requests == ("mission/own",)


def test_what_rorg_is_about_to_end_is_not_relied_on(robot):
    begin(robot, {"base": {}, "arm": {}}, "base", "arm")
    robot.declare({"base": {}, "arm": {"container": {"environment": {"N": "1"}}}})
    robot.suspend(60, "watch")
    robot.wait(lambda: robot.sim.decision.situation.suspended)
    assert set(ready_runs(robot.sim.decision)) == {"base", "arm"}, "nothing happens while rorg is suspended"


# -- states --------------------------------------------------------------------------------------------------------


def changes(robot: VirtualRobot, before: dict[str, str], condition) -> list[StateChange]:
    """All changes of state until a condition holds."""
    found: list[StateChange] = []

    def look() -> bool:
        decision = robot.sim.decision
        for change in state_changes(before, decision):
            found.append(change)
            before[change.service] = change.state
        return condition()

    robot.wait(look)
    return found


def test_states_go_from_none_to_ready_with_their_reasons(robot):
    robot.declare({"base": {}, "arm": {"needs": ["base"]}})
    robot.request("arm")
    before: dict[str, str] = {}
    found = changes(robot, before, lambda: before.get("arm") == READY)
    assert before == {"base": READY, "arm": READY}
    assert [c.state for c in found if c.service == "arm"][-1] == READY
    last = {c.service: c for c in found}
    assert last["arm"].requests == ("developer/test",)
    assert str(last["base"]) == "base is ready (needed by arm)"
    robot.release()
    ended = changes(robot, before, lambda: before["base"] == "exited")
    assert {str(c) for c in ended if c.state == "exited"} == {
        "arm is exited (not wanted)",
        "base is exited (not wanted)",
    }
    assert not any(c.failed for c in ended)


def test_an_end_with_an_error_is_a_failure(robot):
    robot.declare({"base": {"restart": "never"}})
    robot.request("base")
    before: dict[str, str] = {}
    changes(robot, before, lambda: before.get("base") == READY)
    robot.kill("base")
    found = changes(robot, before, lambda: before["base"] == "exited")
    assert [(c.state, c.failed, c.reason) for c in found] == [("exited", True, "ended with exit code 137")]


def test_a_hold_is_the_reason_of_an_end(robot):
    robot.declare({"base": {}})
    robot.request("base")
    before: dict[str, str] = {}
    changes(robot, before, lambda: before.get("base") == READY)
    robot.hold("base", 60, "cleaning")
    found = changes(robot, before, lambda: before["base"] == "exited")
    assert "cleaning" in found[-1].reason
    assert not found[-1].failed


def test_what_is_removed_has_no_container(robot):
    robot.declare({"base": {}, "spare": {"idle": {"action": "remove"}}})
    robot.settle()
    assert state_of(robot.sim.decision, "spare") == NONE
    assert state_of(robot.sim.decision, "base") == "created"
    assert str(StateChange("spare", NONE, "")) == "spare has no container"


@pytest.mark.parametrize(
    ("known", "cause"),
    [
        ({"exited": "RUN", "error": "exit code 1"}, ("crashed", "exit code 1")),
        ({"hung": "RUN", "error": "no answer"}, ("hung", "no answer")),
        ({"incarnation": "another"}, ("restarted", "another run has begun")),
        ({"incarnation": ""}, ("unready", "its probe failed")),
        ({"probe": "refused"}, ("unready", "refused")),
        ({}, ("unready", "its probe failed")),
        ({"running_since": None}, ("ceased", "it no longer runs")),
    ],
)
def test_a_loss_without_an_action_has_the_cause_that_its_run_tells(robot, known, cause):
    before = begin(robot, {"base": {}}, "base")
    decision = robot.sim.decision
    values = {field: before["base"] if value == "RUN" else value for field, value in known.items()}
    progress = replace(decision.memory.of("base"), ready=False, **values)
    later = replace(decision, memory=replace(decision.memory, progress={"base": progress}))
    (one,) = losses(before, {}, later)
    assert (one.cause, one.reason) == cause


def test_a_service_of_another_machine_is_lost_when_it_is_not_ready_or_not_known(robot):
    begin(robot, {"base": {}}, "base")
    decision, run = robot.sim.decision, robot.run_of("base")

    def with_peers(peers: Peers) -> Decision:
        memory = replace(decision.memory, progress={})
        planned = replace(decision.planned, situation=replace(decision.situation, peers=peers))
        return replace(decision, memory=memory, planned=planned)

    there = Remote("running", True, True, "Healthy", "Synced", run)
    assert ready_runs(with_peers(Peers("head", remotes={"base": there}))) == {"base": run}
    down = with_peers(Peers("head", remotes={"base": replace(there, ready=False, reason="refused")}))
    assert ready_runs(down) == {}
    assert [(one.cause, one.reason) for one in losses({"base": run}, {}, down)] == [
        ("unready", "it is not ready: refused")
    ]
    again = with_peers(Peers("head", remotes={"base": replace(there, incarnation="another")}))
    assert [one.reason for one in losses({"base": run}, ready_runs(again), again)] == ["it runs anew"]
    silent = with_peers(Peers("head", unknown={"base": "is on body, which does not answer"}))
    assert [(one.cause, one.reason) for one in losses({"base": run}, {}, silent)] == [
        ("unreachable", "it is on body, which does not answer")
    ]


def test_a_state_is_ready_only_while_it_runs_and_is_ready(robot):
    begin(robot, {"base": {}}, "base")
    decision = robot.sim.decision
    progress = replace(decision.memory.of("base"), ready=False)
    waits = replace(decision, memory=replace(decision.memory, progress={"base": progress}))
    paused = replace(decision.situation.observed, containers=(replace(robot.container("base"), state="paused"),))
    asleep = replace(
        decision, planned=replace(decision.planned, situation=replace(decision.situation, observed=paused))
    )
    assert [state_of(one, "base") for one in (decision, waits, asleep)] == [READY, "running", "paused"]
