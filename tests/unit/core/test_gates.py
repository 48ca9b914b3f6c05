"""What holds an action back (rorg/core/gates.py, deferred.py, joining.py): one rule after another."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from situations import ARM, BASE, EARLIER, NOW, PROBED, RUN, SPEC, box, planned, situation, up

from rorg.core.digest import Rules, labels
from rorg.core.incremental import plan_all
from rorg.core.memory import Attempt, InFlight, Memory, Progress
from rorg.core.observed import LABEL_RULES, Container
from rorg.core.operations import Pause, Start, Stop
from rorg.core.plan import Action, printed
from rorg.core.update import Update
from rorg.core.wanted import Cause
from rorg.model.catalog import Idle, Service, Updating
from rorg.model.probe import Probe
from rorg.model.ros import RosParameters

CHANGED = box(spec={"image": "y"})
"""`base` runs as it was declared before."""
WANTS_ARM = {"wanted": {"arm": (Cause("always_on"),)}}
JOINED = Service("arm", spec={**SPEC, "pid": "service:base"}, needs=("base",), joins={"base": ("pid",)})


def verbs(lines: list[str]) -> list[str]:
    """`verb service` of each action, without the head of a chain."""
    return [" ".join(line.split()[1:3]) for line in lines if line[0] not in ".-"]


def flying(operation: type, name: str = "arm") -> Memory:
    call = operation(container=name)
    known = {"base": up()}
    return Memory(known, in_flight={name: InFlight(Action(0, call, name), EARLIER)})


# -- rivals ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "rules",
    [
        ({"conflicts": ("arm",)}, {}, "conflicts with arm, which is being started"),
        ({}, {"conflicts": ("base",)}, "conflicts with arm, which is being started"),
        ({"exclusive": {"gpu": 1}}, {"exclusive": {"gpu": 1}}, "waits for gpu, which arm still uses"),
    ],
)
def test_a_rival_that_is_being_started_is_waited_for(rules):
    base, arm, why = rules
    services = replace(BASE, **base), replace(ARM, needs=(), **arm)
    seen = box(state="exited"), box("arm", "exited")
    wanted = {"base": (Cause("always_on"),)}
    found = planned(*services, seen=seen, memory=flying(Start), wanted=wanted)
    assert f". wait base {why}" in found
    found = planned(*services, seen=seen, memory=flying(Pause), wanted=wanted)
    assert f". wait base {why}" not in found, "that call starts nothing"


def test_a_paused_service_without_a_manifest_is_not_resumed_beside_its_rival():
    rules = labels("robot", "gone", {}, "", Rules(None, {}, ("arm",)))[LABEL_RULES]
    left, arm = box("gone", "paused", rules=rules), replace(ARM, needs=())
    found = planned(arm, seen=(box("arm"), left))
    assert found == [". wait gone stays paused, because a stop would resume it: conflicts with arm, which is active"]
    found = planned(arm, seen=(box("arm", "exited"), left))
    assert verbs(found) == ["stop gone", "start arm"]
    assert found[-1].endswith("after gone")


@pytest.mark.parametrize(("signal", "waits"), [("SIGINT", True), ("SIGKILL", False)])
def test_a_run_that_a_person_paused_while_it_is_stopped_is_a_rival_until_it_has_ended(signal, waits):
    """The engine resumes it, unless it is killed."""
    call = Stop(container="base", signal=signal, grace=5.0, incarnation=RUN)
    memory = Memory(in_flight={"base": InFlight(Action(0, call, "base"), EARLIER)})
    services = BASE, replace(ARM, needs=(), conflicts=("base",))
    found = planned(*services, seen=(box(state="paused"), box("arm", "exited")), memory=memory, **WANTS_ARM)
    assert (". wait arm conflicts with base, which is active" in found) == waits


# -- needs -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("seen", "known", "unready"),
    [
        (box(), up(), ""),
        (CHANGED, up(), ""),
        (CHANGED, up(ready=False), "is not ready (10 s of 30 s)"),
        (box(state="exited"), Progress(stopped=(RUN,), attempts={}), ""),
    ],
)
def test_a_need_whose_change_has_to_wait_is_as_ready_as_before(seen, known, unready):
    probed = replace(PROBED, update=Updating(when="when_ceased"))
    found = plan_all(situation(probed, ARM, seen=(seen, box("arm", "exited")), known={"base": known}))
    assert printed(found.plans["base"].unready, NOW) == unready


def test_a_need_that_cannot_go_on_says_what_it_waits_for():
    blocked = {"unplugged": {"base": "/dev/arm is missing"}}
    found = plan_all(situation(BASE, ARM, seen=(box(state="exited"), box("arm", "exited")), **blocked))
    assert found.plans["base"].unready == "waits: /dev/arm is missing"
    runs = plan_all(situation(replace(BASE, unplugged="keep"), ARM, seen=(box(), box("arm", "exited")), **blocked))
    assert runs.plans["base"].unready == "", "it goes on without"
    ends = plan_all(situation(BASE, ARM, seen=(box(), box("arm", "exited")), restarts={"base": RUN}, **blocked))
    assert ends.plans["base"].unready == "waits: /dev/arm is missing"


# -- sets ------------------------------------------------------------------------------------------------------


def held(**more: Any) -> list[str]:
    """The plan of `base`, which waits for the new container of `arm`."""
    pair = Updating(atomic="pair")
    services = replace(BASE, update=pair), replace(ARM, needs=(), update=pair)
    known = {"base": up(update=Update(held="arm")), **more.pop("known", {})}
    return planned(*services, seen=more.pop("seen", (CHANGED, box("arm"))), known=known, **more)


def test_a_service_never_waits_for_itself_in_words():
    """Its own new container may be the one that is missing."""
    assert [line for line in held(known={"base": up(update=Update(held="base"))}) if line.startswith(".")] == [
        ". wait base waits until all services that change together with it have new containers"
    ]


def test_what_needs_a_service_that_waits_says_so_once():
    services = replace(BASE, exclusive={"gpu": 1}), replace(ARM, name="lamp", needs=(), exclusive={"gpu": 1})
    ends = box(state="exited"), box("lamp", "exited")
    known = Memory({}, in_flight=flying(Start, "lamp").in_flight)
    found = planned(*services, ARM, seen=(*ends, box("arm", "exited")), memory=known)
    assert ". wait arm base waits for gpu, which lamp still uses" in found


def test_a_run_goes_on_until_all_of_its_set_are_made():
    why = "waits for the new container of arm, which changes together with it"
    assert f". wait base {why}" in held()
    assert "stop base" not in verbs(held())
    idle = held(seen=(replace(CHANGED, state="exited"), box("arm")))
    assert not any(why in line for line in idle), "no run has to end"
    assert "start base" in verbs(idle)
    restarted = held(restarts={"base": RUN})
    assert not any(why in line for line in restarted)
    assert "start base" in verbs(restarted)


# -- joined containers -----------------------------------------------------------------------------------------


def test_a_container_is_made_after_what_it_joins():
    found = planned(BASE, JOINED, seen=())
    assert "+ create arm no container, after base [as arm]" in found
    waits = planned(BASE, JOINED, seen=(), unplugged={"base": "/dev/arm is missing"})
    assert ". wait arm base waits: /dev/arm is missing" in waits
    ready = replace(BASE, ready=Probe("delay", 15.0))
    known = {"base": up(ready=False)}
    late = plan_all(situation(ready, JOINED, seen=(box(),), known=known))
    assert [w.until for w in late.plan().waitings] == [EARLIER + 15.0]


def test_a_task_that_was_removed_has_nothing_to_join():
    task = replace(BASE, restart="never", ready=Probe("completed", ""), idle=Idle(action="remove"))
    found = planned(task, JOINED, seen=(), known={"base": Progress(exited=RUN)}, **WANTS_ARM)
    assert found == [". wait arm base is not running (ended)"]


@pytest.mark.parametrize("joined", [True, False], ids=["wanted", "unwanted"])
def test_what_is_wanted_and_still_joined_holds_back_a_removal(joined):
    old = box(id="old", name="base.1", state="exited", spec={"image": "y"})
    arm = box("arm", "exited", JOINED.spec, joined='{"base": "old"}')
    later = Progress(attempts={"create": Attempt(at=NOW + 9, error="no")})
    wanted = WANTS_ARM["wanted"] if joined else {}
    found = planned(BASE, JOINED, seen=(box(), old, arm), known={"arm": later}, wanted=wanted)
    assert (". wait base arm is still joined to its container" in found) is joined
    assert ("- remove base" in found) is not joined


# -- lingering -------------------------------------------------------------------------------------------------


def test_what_does_not_run_or_is_declared_no_more_waits_for_nobody():
    asleep = replace(BASE, idle=Idle(action="stop"))
    known = {"base": up(ready=False), "arm": up("arm")}
    found = planned(asleep, ARM, seen=(box(state="paused"), box("arm")), known=known, wanted={})
    assert verbs(found)[-1] == "stop base"
    (stop,) = [line for line in found if " stop base" in line]
    assert "after arm" not in stop
    left = planned(ARM, seen=(box(), box("arm")), known={"arm": up("arm")}, **WANTS_ARM)
    assert any(line.split()[1:3] == ["stop", "base"] for line in left), "though arm still names it"


def test_without_a_time_to_linger_a_service_ends_at_once():
    known = {"base": up(unwanted_since=NOW)}
    assert verbs(planned(BASE, seen=(box(),), known=known, wanted={})) == ["stop base"]


# -- changes that wait -----------------------------------------------------------------------------------------

WAITS = replace(BASE, update=Updating(when="when_ceased"))
LATER = ". wait base changed: image; takes effect when the service next idles or restarts"


def test_a_change_waits_for_the_end_of_the_run_if_its_service_says_so():
    assert planned(WAITS, seen=(CHANGED,)) == [LATER]
    assert "stop base" in verbs(planned(BASE, seen=(CHANGED,)))


@pytest.mark.parametrize(
    "more",
    [
        {"seen": (replace(CHANGED, state="exited"),), "known": {"base": Progress(stopped=(RUN,))}},
        {"restarts": {"base": RUN}},
        {"wanted": {}},
    ],
    ids=["it does not run", "it is restarted", "it is not wanted"],
)
def test_a_change_is_made_when_the_run_ends_anyway(more):
    found = planned(WAITS, **{"seen": (CHANGED,), **more})
    assert LATER not in found
    assert "create base" in verbs(found)


FILE = {"base": {"/map": "2"}}
READ = Update(run=RUN, content={"/map": "1"})


def reading(service: Service = BASE, seen: Container = box(), **more: Any) -> list[str]:
    """The plan after a mounted file has changed."""
    found = situation(service, seen=(seen,), known={"base": up(update=READ)}, **more)
    found = replace(found, desired=replace(found.desired, contents=FILE))
    plan = plan_all(found).plan()
    return [" ".join(line.split()) for line in plan.text().splitlines()[:-1]] if not plan.empty else []


def test_a_run_is_restarted_for_a_file_that_it_has_read():
    assert verbs(reading()) == ["stop base", "start base"]
    assert reading(replace(BASE, on_change="none")) == []
    assert verbs(reading(replace(BASE, on_change="SIGHUP"))) == ["signal base"]
    assert reading(WAITS) == [". wait base changed: /map; takes effect when the service next idles or restarts"]


def test_a_run_that_has_ended_or_is_not_wanted_reads_files_at_its_next_start():
    assert reading(seen=box(state="exited")) == ["> start base always on [reads /map]"]
    assert reading(WAITS, seen=box(state="exited")) == ["> start base always on [reads /map]"]
    assert verbs(reading(wanted={})) == ["stop base"]
    assert not any("changed" in line for line in reading(wanted={}))


ROS = replace(BASE, ros=RosParameters("ros", {"/a": 1}), domain=0)
REFUSED = up(not_set="no such parameter", begun_with=(RUN, "before"))
NOT_SET = ". wait base its ROS parameters are not set: no such parameter"


@pytest.mark.parametrize(
    ("service", "seen", "known", "told"),
    [
        (ROS, box(), REFUSED, True),
        (ROS, box(state="paused"), REFUSED, False),
        (ROS, box(state="exited"), replace(REFUSED, stopped=(RUN,)), False),
        (ROS, box(), replace(REFUSED, not_set=""), False),
        (ROS, box(), replace(REFUSED, begun_with=("another run", "before")), False),
        (ROS, box(), replace(REFUSED, begun_with=(RUN, situation(ROS).desired.ros["base"])), False),
        (BASE, box(), REFUSED, False),
    ],
)
def test_parameters_that_a_program_does_not_take_are_told_while_it_runs(service, seen, known, told):
    assert (NOT_SET in planned(service, seen=(seen,), known={"base": known})) is told


def test_a_program_of_ros_1_starts_after_its_parameters_are_set():
    ros = replace(ROS, domain=None)
    stopped = Progress(stopped=(RUN,))
    idle = box(state="exited")
    assert planned(ros, seen=(idle,), known={"base": stopped}) == [". wait base its ROS parameters are not set"]
    why = replace(stopped, not_set="refused")
    assert planned(ros, seen=(idle,), known={"base": why}) == [". wait base its ROS parameters are not set: refused"]
    assert planned(ROS, seen=(idle,), known={"base": stopped}) == ["> start base always on"], "ROS 2: as it runs"
