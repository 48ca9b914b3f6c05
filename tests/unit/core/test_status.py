"""What the status of a service says in each situation: health, why it is wanted, and what keeps it from being ready."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from robots import VirtualRobot
from statuses import statuses

from rorg.core.conditions import Condition
from rorg.core.desired import desire
from rorg.core.links import Remote
from rorg.core.memory import Attempt, InFlight, Memory, Progress
from rorg.core.observed import Container, Observed, Silence
from rorg.core.operations import Pause, Rename, Start, Stop
from rorg.core.peers import Peers
from rorg.core.plan import Action, Part, Plan, Waiting
from rorg.core.situation import Measures, Situation
from rorg.core.status import Status, Statuses, ros_nodes
from rorg.core.update import Update
from rorg.core.wanted import Cause
from rorg.model.catalog import Catalog, Idle, Service
from rorg.model.probe import Probe

PROBED = {"ready": {"tcp": 1234, "timeout": "5s"}}


@pytest.fixture
def robot(tmp_path):
    return VirtualRobot(tmp_path)


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
    assert spare.condition("Requested") == Condition("Requested", "False", "NotWanted")
    assert arm.condition("Requested").reason == "Wanted"
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
    assert found["base"].trouble == found["base"].held != ""
    assert "cleaning" in found["base"].held
    assert found["arm"].trouble == "waits for gpu, which is taken by drive"
    assert {n: found[n].why for n in ("base", "arm")} == dict.fromkeys(("base", "arm"), "requested by developer (test)")
    assert [found[n].health for n in ("base", "arm", "drive")] == ["Waiting", "Preempted", "Healthy"]
    assert (found["arm"].rivals, found["base"].rivals, found["drive"].rivals) == (("drive",), (), ())
    assert not found["arm"].wanted
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


# -- case by case ----------------------------------------------------------------------------------------------


BASE = Service("base", spec={"image": "x"}, ready=Probe("tcp", 80, timeout=30.0), priority=40)
DIGEST = desire(Catalog(services={"base": BASE})).digests["base"]
STARTED = "2026-01-01T12:00:00Z"
RUN = f"aaaaaaaaaaaa@{STARTED}"
UP = Progress(incarnation=RUN, running_since=90.0, ready=True, was_ready=True)
STOP = Stop(container="a" * 64, signal="SIGTERM", grace=5.0, incarnation=RUN)


def box(state: str = "running", **more: Any) -> Container:
    return Container("a" * 64, "base", "base", state, STARTED, **{"digest": DIGEST, **more})


def status(
    *seen: Container, progress: Progress = UP, plan: Plan = Plan(), held: str = "", service: Service = BASE, **more: Any
) -> Status:
    """The status of `base` in a situation in which it is wanted, a hundred seconds after rorg began."""
    facts = {
        "wanted": {"base": (Cause("always_on"),)},
        "observed": Observed(seen),
        "memory": Memory({"base": progress}),
    }
    desired = desire(Catalog(services={"base": service}))
    situation = Situation(
        **{"desired": desired, "now": 100.0, "owner": "robot", "urgent": frozenset(), **facts, **more}
    )
    return Statuses(situation, plan, {"base": held} if held else {})["base"]


@pytest.mark.parametrize(
    ("seen", "progress", "ready", "message", "health"),
    [
        (box(), UP, "Ready", "", "Healthy"),
        (box(), replace(UP, ready=False, probe="refused"), "Probing", "refused", "Progressing"),
        (box(), replace(UP, ready=False, probe="no", running_since=69.9), "Late", "no", "Degraded"),
        (box(), replace(UP, ready=False, running_since=70.0), "Probing", "", "Progressing"),
        (
            box(),
            replace(UP, ready=False, doubted_since=99.0),
            "Ending",
            "rorg was ended while stopping it",
            "Progressing",
        ),
        (box(), replace(UP, ready=False, running_since=None), "Running", "", "Progressing"),
        (box("exited"), Progress(exited=RUN, exits=1, error="code 1"), "Failed", "code 1", "Degraded"),
        (box("exited"), Progress(exited=RUN, exits=0, error="code 1"), "Failed", "code 1", "Degraded"),
        (box("exited", oom_killed=True), Progress(exited=RUN, error="memory"), "OutOfMemory", "memory", "Degraded"),
        (box("exited"), Progress(), "Exited", "", "Progressing"),
        (box("exited", error="no such file"), Progress(), "Exited", "no such file", "Progressing"),
        (box("created"), Progress(error="no start"), "Created", "no start", "Progressing"),
        (box("created"), Progress(error="no start", exits=1), "Failed", "no start", "Degraded"),
        (box("created"), Progress(exits=3), "Created", "", "Degraded"),
        (box("paused"), Progress(exited=RUN), "Paused", "", "Progressing"),
    ],
)
def test_readiness_has_a_reason_in_every_state(seen, progress, ready, message, health):
    found = status(seen, progress=progress)
    condition = found.condition("Ready")
    assert (condition.reason, condition.message, found.health) == (ready, message, health)
    assert condition.status == str(ready == "Ready")
    assert found.trouble == message
    assert status(seen, progress=progress, wanted={}).health == "Idle"


def test_a_task_is_completed_by_a_good_end():
    task, ended = replace(BASE, restart="never"), Progress(exited=RUN, error="ended with exit code 0")
    done = status(box("exited", exit_code=0), progress=ended, service=task)
    assert (ready(done), done.health, done.trouble) == (("True", "Completed"), "Completed", "")
    assert done.condition("Ready").message == "it ended with exit code 0"
    again = status(box("exited", exit_code=0), progress=ended)
    assert (ready(again), again.health) == (("False", "Failed"), "Degraded")


def test_what_it_waits_for_is_its_trouble():
    waits = Plan(waitings=(Waiting("base", "roscore is not ready"),))
    for seen in ([box("exited")], [box("created")], []):
        found = status(*seen, progress=Progress(exited=RUN, error="bad"), plan=waits)
        assert (found.sync, found.trouble) == ("Synced" if seen else "OutOfSync", "roscore is not ready")
        assert found.condition("Ready").message == "roscore is not ready"
        assert found.condition("Reconciling").message == "roscore is not ready"
    assert status(progress=Progress(error="bad")).trouble == "bad"
    held = status(box("exited"), plan=waits, progress=Progress(), wanted={}, held="held")
    assert (held.trouble, held.why, held.held) == ("", "held", "held")
    assert status(box(), wanted={}, preempted={"base": "arm has priority"}).why == "arm has priority"


@pytest.mark.parametrize(
    ("seen", "more", "sync"),
    [
        ([box()], {}, "Synced"),
        ([box()], {"wanted": {}}, "Synced"),
        ([], {"wanted": {}}, "OutOfSync"),
        ([], {"wanted": {}, "service": replace(BASE, idle=Idle(action="remove"))}, "Synced"),
        ([], {"service": replace(BASE, idle=Idle(action="remove"))}, "OutOfSync"),
        ([box(digest="v1:another")], {}, "OutOfSync"),
        ([replace(box(), name="another")], {}, "OutOfSync"),
    ],
)
def test_sync_says_whether_the_container_is_as_declared(seen, more, sync):
    lingers = Plan(waitings=(Waiting("base", "lingers for 3 s"),))
    assert status(*seen, plan=lingers, **more).sync == sync
    action = Plan((Action(0, Start(container="a" * 64), "base"),))
    assert status(*seen, plan=action, **more).sync == sync


@pytest.mark.parametrize(("code", "health"), [("no-image", "Degraded"), ("image", "Progressing")])
def test_a_missing_image_of_a_wanted_service_is_shown(code, health):
    waits = Plan(waitings=(Waiting("base", "image y is missing", code=code),))
    runs_on = status(box(digest="v1:another"), plan=waits)
    assert (ready(runs_on), runs_on.sync, runs_on.health) == (("True", "Ready"), "OutOfSync", health)
    assert runs_on.trouble == "image y is missing"
    never_made = status(plan=waits, progress=Progress())
    assert (never_made.health, never_made.trouble) == (health, "image y is missing")
    assert status(plan=waits, progress=Progress(), wanted={}).trouble == ""


def test_a_silent_engine_is_told_once_for_all():
    silence = Silence("unix:///docker.sock", 0.0, "timed out")
    found = status(observed=Observed((box(),), complete=False, silence=silence))
    assert ready(found) == ("Unknown", "EngineSilent")
    assert "timed out" in found.condition("Ready").message
    assert found.trouble == ""


@pytest.mark.parametrize(
    ("action", "ending"),
    [
        (Action(0, STOP, "base", "changed"), "stop: changed"),
        (Action(0, Pause(container="a" * 64), "base", "not wanted"), "pause: not wanted"),
        (Action(0, replace(STOP, container="b" * 64), "base"), ""),
        (Action(0, Start(container="a" * 64), "base"), ""),
        (Action(0, Rename(container="a" * 64, name="x"), "base", "changed", part_of=Part.REPLACE), "rename: changed"),
        (Action(0, Rename(container="a" * 64, name="x"), "base", "changed"), ""),
        (Action(0, Start(container="b" * 64), "base", "changed", part_of=Part.REPLACE), ""),
    ],
)
def test_a_run_is_not_ready_once_it_is_about_to_end(action, ending):
    said = ("False", "Ending") if ending else ("True", "Ready")
    flying = Memory({"base": UP}, in_flight={"base": InFlight(action, 99.0)})
    for found in (status(box(), plan=Plan((action,))), status(box(), memory=flying)):
        assert (ready(found), found.condition("Ready").message) == (said, ending)
        assert found.condition("Reconciling").reason == action.verb.capitalize()
    assert ready(status(box(), memory=flying, suspended="by a person")) == said
    suspended = status(box(), plan=Plan((action,)), suspended="by a person")
    assert ready(suspended) == ("True", "Ready"), "then nothing begins"


def test_no_device_is_told_while_it_does_not_run():
    missing = {"unplugged": {"base": "its device is missing"}}
    for seen in ([], [box("exited")], [box("paused")]):
        found = status(*seen, progress=Progress(), **missing)
        assert (ready(found), found.health, found.trouble) == (
            ("False", "NoDevice"),
            "Degraded",
            "its device is missing",
        )
    assert ready(status(box(), progress=replace(UP, ready=False), **missing)) == ("False", "Probing")


def test_a_failed_change_is_the_trouble_even_of_a_healthy_service():
    edition = Update(edition="now", quarantined={"now": "late"})
    found = status(box(), progress=replace(UP, update=edition))
    assert found.update_failed == "late; change it again, or `rorg retry base`"
    assert found.trouble == f"its change failed: {found.update_failed}"
    assert found.condition("Updated").reason == "Quarantined"
    assert status(box()).update_failed == ""


@pytest.mark.parametrize(("now", "reason"), [(91.9, "OnTrial"), (92.0, "Baking")])
def test_a_change_is_on_trial_until_it_has_come_up(now, reason):
    old = Container("b" * 64, "base.old", "base", "exited")
    new, service = box(previous=old.id), replace(BASE, ready=None)
    well = replace(UP, well_since=90.0)
    observed = Observed((new, old), looked={new.id: now, old.id: 0.0})
    found = status(progress=well, service=service, observed=observed, now=now)
    assert (found.condition("Updated").status, found.condition("Updated").reason) == ("Unknown", reason)
    assert not found.update_failed
    for seen in ((new,), (replace(new, state="exited"), old), (box(), old)):
        assert status(*seen, progress=well, service=service).condition("Updated").reason == ""


@pytest.mark.parametrize(
    ("progress", "stalled"),
    [
        (Progress(exits=2), "Fine"),
        (Progress(exits=3), "CrashLoop"),
        (Progress(attempts={"create": Attempt(count=2)}), "Fine"),
        (Progress(attempts={"create": Attempt(count=3)}), "RepeatedFailure"),
    ],
)
def test_three_failures_in_a_row_are_a_stall(progress, stalled):
    found = status(box("exited"), progress=replace(progress, error="bad"))
    condition = found.condition("Stalled")
    assert (condition.status, condition.reason, condition.message) == (str(stalled != "Fine"), stalled, "bad")
    assert found.health == ("Progressing" if stalled == "Fine" else "Degraded") or progress.exits


def test_a_service_that_may_run_anywhere_may_run_twice():
    anywhere = replace(BASE, machine="any")

    def caution(*seen: Container, service: Service = anywhere, **more: Any) -> tuple[str, str]:
        found = status(*seen, service=service, **more).condition("RunsOnce")
        return found.reason, found.message

    twice = "while the network of the Swarm is split, it may run twice"
    lost = box(node="n1", error="its node is down")
    assert caution(box(node="n1")) == ("Swarm", f"it runs on n1; {twice}")
    assert caution(lost) == ("NodeLost", "it runs on n1; its node is down")
    assert caution(replace(lost, state="paused")) == ("Swarm", f"it runs on n1; {twice}")
    assert caution(replace(lost, node="")) == caution() == caution(replace(lost, state="exited")) == ("Swarm", twice)
    assert caution(box(), service=BASE) == caution(box(), wanted={}) == ("", "")
    assert status(box(), service=anywhere).cautions == [twice]


@pytest.mark.parametrize(
    ("remote", "said"),
    [
        (Remote("running", True, True, "Healthy", "Synced", RUN), ("True", "Ready", "")),
        (
            Remote("exited", True, False, "Degraded", "Synced", "", "it crashed"),
            ("False", "NotReady", "is not ready: it crashed"),
        ),
        (None, ("Unknown", "NoAnswer", "is on head, which has not answered yet")),
    ],
)
def test_the_status_of_another_machines_service_is_what_that_one_told(remote, said):
    away = replace(BASE, spec=None, machine="head", away="head", driver=True, labels={"team": "arm"})
    peers = Peers("body", remotes={"base": remote} if remote else {})
    found = status(service=away, peers=peers)
    ready = found.condition("Ready")
    assert (ready.status, ready.reason, ready.message) == said
    there = remote or Remote("unknown", False, False, "Unknown", "Unknown")
    assert (found.state, found.sync, found.health, found.wanted) == (there.state, there.sync, there.health, True)
    assert (found.incarnation, found.started_at) == ((RUN, STARTED) if there.incarnation else ("", ""))
    assert (found.machine, found.effective_priority, found.driver, found.labels) == ("head", 40, True, {"team": "arm"})
    assert found.why == "always on"


def test_the_container_and_its_run_are_told():
    found = status(box(pid=7), progress=replace(UP, exits=1, crashes=2), priorities={"base": 70})
    assert (found.container, found.incarnation, found.started_at, found.pid) == ("a" * 64, RUN, STARTED, 7)
    assert (found.exits, found.crashes, found.effective_priority, found.lowered) == (1, 2, 70, False)
    assert status(box("exited"), progress=Progress()).incarnation == ""
    assert status(box(), measures=Measures(lowered=frozenset({"base"}))).lowered
    entry = found.as_json()
    assert (entry["message"], entry["wanted"], entry["ros_nodes"], "chain" in entry) == ("", True, [], False)
    assert [str(link) for link in found.chain] == ["base (always on)"]
    twice = status(box(), wanted={"base": (Cause("always_on"), Cause("needed", "arm"))})
    assert twice.why == "always on and 1 more"
    meta = status(service=replace(BASE, meta=True, spec=None))
    assert (meta.state, meta.sync, meta.health, meta.wanted) == ("meta", "Synced", "Healthy", True)
