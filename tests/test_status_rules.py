"""What the status of a service says in each situation: health, why it is wanted, and what keeps it from being ready."""

from __future__ import annotations

from dataclasses import replace

import pytest
from robots import VirtualRobot

from rorg.core.status import Status, Statuses, ros_nodes

PROBED = {"ready": {"tcp": 1234, "timeout": "5s"}}


@pytest.fixture
def robot(tmp_path):
    return VirtualRobot(tmp_path)


def statuses(robot: VirtualRobot, **changes: object) -> Statuses:
    decision = robot.sim.decision
    return Statuses(replace(decision.situation, **changes), decision.plan, decision.holds)


def ready(status: Status) -> tuple[str, str]:
    found = status.condition("Ready")
    return found.status, found.reason


def test_what_is_as_wanted(robot):
    robot.declare({"base": {"labels": {"team": "arm"}}, "arm": {"needs": ["base"], "priority": 70}, "spare": {}})
    robot.request("arm")
    robot.request("arm", id="again")
    robot.settle()
    found = statuses(robot)
    assert list(found) == ["arm", "base", "developer", "spare"]
    assert len(found) == 4
    assert "spare" in found
    assert "gone" not in found
    arm, base, spare = found["arm"], found["base"], found["spare"]
    assert found["arm"] is arm, "found once"
    assert (arm.sync, arm.health, arm.state, arm.wanted, ready(arm)) == (
        "Synced",
        "Healthy",
        "running",
        True,
        ("True", "Ready"),
    )
    assert arm.why == "requested by developer (test) and 1 more"
    assert base.why == "needed by arm"
    assert (spare.health, spare.wanted, spare.why, spare.incarnation) == ("Idle", False, "", "")
    assert arm.incarnation == robot.run_of("arm")
    assert (base.effective_priority, base.labels) == (70, {"team": "arm"})
    assert arm.trouble == spare.trouble == ""
    assert arm.condition("Nothing").status == "Unknown"
    with pytest.raises(KeyError):
        found["gone"]


def test_a_probe_that_does_not_answer_is_late_after_its_time(robot):
    robot.declare({"base": PROBED})
    robot.sim.faults.bad[robot.sim.desired.digests["base"]] = "probe"
    robot.request("base")
    robot.wait(lambda: robot.active() == {"base"})
    since = robot.sim.decision.situation.memory.of("base")
    memory = robot.sim.decision.situation.memory
    running = replace(since, running_since=10.0, ready=False, probe="no answer")
    memory = replace(memory, progress={"base": running})
    early, late = (statuses(robot, memory=memory, now=now)["base"] for now in (15.0, 15.1))
    assert (ready(early), early.health) == (("False", "Probing"), "Progressing")
    assert (ready(late), late.health) == (("False", "Late"), "Degraded")
    assert late.trouble == "no answer"


def test_a_failed_end_is_told_and_an_end_that_is_well_is_no_failure(robot):
    robot.declare({"base": {"restart": "never"}})
    robot.request("base")
    robot.wait(lambda: "base" in robot.active())
    robot.settle()
    robot.kill("base")
    robot.settle()
    failed = statuses(robot)["base"]
    assert (ready(failed), failed.health, failed.trouble) == (
        ("False", "Failed"),
        "Degraded",
        "ended with exit code 137",
    )
    assert (failed.exits, failed.crashes) == (1, 1)


def test_before_the_engine_has_answered_nothing_is_known(robot):
    robot.declare({"base": {"always_on": True}})
    robot.settle()
    unknown = replace(robot.sim.decision.situation.observed, complete=False, containers=())
    found = statuses(robot, observed=unknown)["base"]
    assert (found.state, found.sync, found.health) == ("unknown", "Unknown", "Unknown")
    assert found.condition("Ready").status == "Unknown"
    memory = replace(robot.sim.decision.situation.memory, progress={})
    nothing = statuses(robot, observed=replace(unknown, complete=True), memory=memory)["base"]
    assert (nothing.state, ready(nothing)) == ("none", ("False", "NoContainer"))


def test_a_run_that_is_about_to_end_is_not_ready(robot):
    robot.declare({"base": {"always_on": True}})
    robot.settle()
    ending = statuses(robot, restarts={"base": robot.run_of("base")})["base"]
    assert (ready(ending), ending.trouble) == (("False", "Ending"), "restart requested")
    assert ready(statuses(robot, restarts={"base": "another run"})["base"]) == ("True", "Ready")


def test_a_service_without_its_device_says_so_unless_it_runs(robot):
    robot.declare({"base": {"always_on": True}, "arm": {}})
    robot.settle()
    missing = {"base": "its device is missing", "arm": "its device is missing"}
    found = statuses(robot, unplugged=missing)
    assert ready(found["arm"]) == ("False", "NoDevice")
    assert found["arm"].condition("Ready").message == "its device is missing"
    assert ready(found["base"]) == ("True", "Ready")


def test_what_a_person_holds_and_what_gives_way_say_why(robot):
    robot.declare({"base": {}, "arm": {"exclusive": ["gpu"]}, "drive": {"exclusive": ["gpu"], "priority": 90}})
    robot.request("base", "arm", "drive")
    robot.hold("base", 100, "cleaning")
    robot.wait(lambda: robot.active() == {"drive"} and robot.waits("arm"))
    found = statuses(robot)
    assert found["base"].why == found["base"].held != ""
    assert "cleaning" in found["base"].held
    assert found["arm"].why == "waits for gpu, which is taken by drive"
    assert found["drive"].held == ""


def test_a_withheld_removal_is_told(robot):
    robot.declare({"base": {"always_on": True}})
    robot.settle()
    kept = statuses(robot, withheld={"base": "tool needed it"})["base"]
    assert (kept.withheld, kept.why) == ("tool needed it", "withheld: tool needed it")
    current = replace(robot.container("base"), service="gone", id="f" * 12)
    observed = replace(robot.sim.decision.situation.observed, containers=(current,))
    found = statuses(robot, withheld={"gone": "tool needed it", "none": "it"}, observed=observed)
    assert "none" not in found, "it has no container"
    assert (found["gone"].state, found["gone"].container, found["gone"].sync) == ("running", "f" * 12, "OutOfSync")


def test_nodes_are_those_of_probes_managed_ones_and_those_in_the_label(robot):
    spec = {"profile": "ros2", "command": "nav", "ros": {"lifecycle": ["/nav"]}, "labels": {"ros_nodes": "/a /nav"}}
    robot.declare({"nav": spec, "base": {}})
    robot.settle()
    services = robot.sim.desired.catalog.services
    assert ros_nodes(services["nav"]) == ("/nav", "/a")
    assert ros_nodes(services["base"]) == ()
