"""When a probe is asked again, and whether an answer is new enough for who waits for it."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from robots import VirtualRobot
from situations import BASE, EARLIER, PROBED, RUN, box, situation

from rorg.core.digest import Rules, labels
from rorg.core.incremental import plan_all
from rorg.core.memory import Memory, ProbeResult, Progress, delay, together
from rorg.core.observed import LABEL_RULES
from rorg.core.pressure import Pressure
from rorg.core.schedule import Schedule, Target, denied_since, interlocks, schedule, told_since
from rorg.core.update import Update
from rorg.model.catalog import Service
from rorg.model.probe import Probe
from rorg.model.ros import RosParameters

HTTP = {"ready": {"tcp": 1234, "interval": "200ms"}}


@pytest.fixture
def robot(tmp_path):
    found = VirtualRobot(tmp_path)
    found.declare({"base": {**HTTP, "live": {"tcp": 1234}}, "plain": {}, "slow": {"ready": {"delay": "5s"}}})
    found.request("base", "plain", "slow")
    found.wait(lambda: found.sim.decision.memory.of("base").ready)
    return found


def target(robot: VirtualRobot, **more: object) -> Target:
    return Target(robot.sim.desired.catalog.services["base"].ready, "run", 1.0, **more)


def test_the_interval_doubles_with_failures_up_to_its_limit(robot):
    doubling = target(robot, longest=10.0)
    assert [doubling.next_after(failures) for failures in (0, 1, 2, 3, 4, 5, 6)] == [
        1.0,
        1.0,
        2.0,
        4.0,
        8.0,
        10.0,
        10.0,
    ]
    assert target(robot).next_after(9) == 1.0, "without a limit it does not double"
    assert target(robot, longest=1e9).next_after(99) == 1024.0
    assert replace(doubling, every=20.0).next_after(5) == 20.0


def test_several_questions_are_asked_at_their_own_intervals_but_no_faster(robot):
    single = target(robot)
    assert single.parts() == (single,)
    quick, slow = (replace(single.probe, interval=interval) for interval in (0.2, 3.0))
    both = replace(single, probe=replace(single.probe, parts=(quick, slow)))
    assert [(t.probe, t.every, t.part) for t in both.parts()] == [(quick, 1.0, 0), (slow, 3.0, 1)]


def test_an_answer_counts_from_the_moment_on_since_which_somebody_waits():
    never, at_five = Progress(), Progress(answered=5.0)
    assert told_since(never, None)
    assert not told_since(never, 1.0)
    assert told_since(at_five, 5.0)
    assert not told_since(at_five, 5.1)


def test_a_denial_counts_unless_a_success_followed_it():
    assert not denied_since(Progress(), 0.0)
    assert denied_since(Progress(denied=5.0), 5.0)
    assert not denied_since(Progress(denied=5.0), 5.1)
    assert denied_since(Progress(denied=5.0, answered=4.0), 1.0)
    assert not denied_since(Progress(denied=5.0, answered=5.0), 1.0)
    assert not denied_since(Progress(denied=5.0, answered=6.0), 1.0)


def test_the_next_time_is_the_first_that_is_still_to_come():
    schedule = Schedule(times={"a": (1.0, 4.0), "b": (3.0,)}, targets={}, looks={}, asked={}, engaged=False)
    assert [schedule.next(now) for now in (0.0, 1.0, 3.5, 4.0)] == [1.0, 3.0, 4.0, None]


def test_only_what_can_change_is_probed(robot):
    """A delay needs no probe, nor does a service that is ready for good; `live` is asked from then on."""
    robot.wait(lambda: robot.sim.decision.memory.of("slow").ready)
    robot.wait(lambda: set(robot.sim.decision.to_probe) == {("base", "live")})
    robot.release()
    robot.wait(lambda: not robot.active())
    assert not robot.sim.decision.to_probe


def test_a_readiness_that_can_be_lost_is_asked_for_more_slowly(tmp_path):
    robot = VirtualRobot(tmp_path)
    robot.declare({"base": {"ready": {"tcp": 1234, "interval": "200ms", "failures": 3}}})
    robot.request("base")
    found: list[float] = []
    robot.wait(lambda: robot.active() and found.append(robot.sim.decision.to_probe["base", "ready"].every) is None)
    robot.wait(lambda: robot.sim.decision.to_probe["base", "ready"].every == 1.0)
    assert robot.sim.decision.memory.of("base").ready
    assert (found[0], robot.sim.decision.to_probe["base", "ready"].every) == (0.2, 1.0)


@pytest.mark.parametrize(("failures", "seconds"), [(0, 0), (1, 0), (2, 1), (3, 2), (4, 4), (7, 32), (8, 60), (99, 60)])
def test_the_back_off_doubles_up_to_a_minute(failures, seconds):
    assert delay(failures) == seconds


def test_answers_to_several_questions_are_one(robot):
    single = target(robot).probe
    probe = replace(single, parts=(single, replace(single, interval=3.0)))
    yes, no = ProbeResult("run", True, 5.0, probe=probe), ProbeResult("run", False, 3.0, "refused", 2, probe)
    assert together(single, [no]) == replace(no, probe=single)
    assert together(single, [None]) is None
    assert together(probe, [None, None]) is None
    assert together(probe, [yes, replace(yes, at=4.0)]) == replace(yes, at=4.0)
    assert together(probe, [yes, no]) == no
    assert together(probe, [no, no]) == no, "the same answer is told once"
    assert not together(probe, [yes, None]).ok
    assert together(probe, [yes, None]).message.endswith("has not answered yet")


# -- one service, in each situation ----------------------------------------------------------------------------

RUNS = Progress(incarnation=RUN, running_since=EARLIER, update=Update(edition="e", baked="e", well="base"))
READY = replace(RUNS, ready=True, was_ready=True, well_since=EARLIER, answered=95.0)
LIVE = replace(PROBED, live=Probe("tcp", 81, interval=2.0))
CHECKED = replace(PROBED, ready=replace(PROBED.ready, failures=3))


def scheduled(
    *services: Service,
    known: Progress = RUNS,
    asked: dict[str, float] | None = None,
    kept: Schedule | None = None,
    **more: Any,
) -> Schedule:
    more = {"seen": (box(),), "known": {"base": known}, **more}
    return schedule(kept, plan_all(situation(*services, **more)), asked or {})


def probes(*services: Service, **more: Any) -> dict[str, tuple[float, float | None]]:
    """Role -> (seconds between two questions, since when an answer is waited for)."""
    return {role: (t.every, t.asked) for (_, role), t in scheduled(*services, **more).targets.items()}


def test_readiness_is_asked_until_it_is_told():
    assert probes(PROBED) == {"ready": (0.25, None)}
    assert probes(PROBED, known=READY) == {}
    assert probes(PROBED, known=replace(RUNS, running_since=None), seen=(box(state="exited"),)) == {}
    assert probes(PROBED, wanted={}) == {}
    assert probes(replace(BASE, ready=Probe("delay", 5.0))) == {}
    assert probes(BASE) == {}


def test_readiness_that_can_be_lost_is_asked_on_more_slowly():
    assert probes(CHECKED, known=READY) == {"ready": (1.0, None)}
    slow = replace(CHECKED, ready=replace(CHECKED.ready, interval=4.0))
    assert probes(slow, known=READY) == {"ready": (4.0, None)}
    assert probes(CHECKED) == {"ready": (0.25, None)}


def test_who_waits_has_it_asked_again():
    assert probes(PROBED, known=READY, asked={"base": 96.0}) == {"ready": (0.25, 96.0)}
    assert probes(PROBED, known=READY, asked={"base": 95.0}) == {}, "that was answered"
    assert probes(PROBED, known=replace(READY, answered=None), asked={"base": 96.0}) == {}, "nothing is known to be old"
    unproven = replace(READY, unproven_since=98.0)
    assert probes(PROBED, known=unproven) == {"ready": (0.25, 98.0)}
    assert probes(PROBED, known=unproven, asked={"base": 99.0}) == {"ready": (0.25, 99.0)}
    assert probes(CHECKED, known=unproven) == {"ready": (0.25, 98.0)}


def test_what_was_ready_is_asked_whether_it_lives():
    assert probes(LIVE) == {"ready": (0.25, None)}
    assert probes(LIVE, known=READY) == {"live": (2.0, None)}
    assert probes(LIVE, known=replace(READY, unproven_since=98.0))["live"] == (2.0, 98.0)


LOCKED = replace(BASE, interlock=Probe("tcp", "82", interval=3.0))


def test_an_interlock_is_asked_only_before_something_may_be_done():
    assert probes(LOCKED, known=READY) == {}
    assert probes(LOCKED, known=READY, restarts={"base": RUN}) == {"interlock": (3.0, None)}
    pressed = Memory({"base": READY}, pressure=Pressure(level=1))
    assert probes(LOCKED, memory=pressed) == {"interlock": (3.0, None)}
    idle = Memory({"base": replace(READY, running_since=None, ready=False)}, pressure=Pressure(level=1))
    assert probes(LOCKED, memory=idle, wanted={}, seen=(box(state="exited"),)) == {}


def test_the_interlock_of_what_is_declared_no_more_is_on_its_label():
    rules = labels("robot", "gone", {}, "", Rules(interlock=LOCKED.interlock))[LABEL_RULES]
    left = box("gone", rules=rules)
    assert probes(BASE, seen=(box(), left), known=READY)["interlock"] == (3.0, None)
    found = situation(BASE, seen=(box(), left))
    assert interlocks(found.desired, found.observed) == {"gone": LOCKED.interlock}
    named = situation(LOCKED, seen=(box(rules=rules),))
    assert interlocks(named.desired, named.observed) == {"base": LOCKED.interlock}
    assert probes(BASE, seen=(box(), box("gone")), known=READY) == {}


def test_parameters_are_set_before_the_start_or_at_a_running_program():
    ros1 = replace(BASE, ros=RosParameters("ros", {"/a": 1}))
    idle = {"seen": (box(state="exited"),), "known": Progress(stopped=(RUN,))}
    (target,) = scheduled(ros1, **idle).targets.values()
    assert (target.anew, target.every, target.longest, target.values) == (True, 1.0, 8.0, {"/a": 1})
    assert scheduled(ros1, known=READY).targets, "it runs without them"
    assert not scheduled(ros1, known=READY, wanted={}).targets
    assert not scheduled(BASE, **idle).targets


@pytest.mark.parametrize(
    ("service", "known", "times"),
    [
        (BASE, READY, set()),
        (replace(BASE, ready=Probe("delay", 15.0)), RUNS, {105.0}),
        (replace(BASE, ready=Probe("delay", 15.0)), READY, set()),
        (replace(BASE, ready=Probe("delay", 15.0)), replace(RUNS, running_since=None), set()),
        (PROBED, RUNS, {120.0}),
        (PROBED, READY, set()),
        (PROBED, replace(READY, update=Update(edition="e")), {92.0, 122.0}),
        (BASE, replace(READY, well_since=90.5, update=Update(edition="e")), {93.0}),
    ],
)
def test_what_is_due_later_is_known(service, known, times):
    found = scheduled(service, known=known).times.get("base", ())
    assert times <= set(found)
    assert bool(found) is bool(times)


def test_a_verdict_says_which_container_must_be_looked_at():
    unproven = replace(READY, unproven_since=98.0)
    assert scheduled(BASE, known=unproven).looks == {"base": ("base", 98.0)}
    assert scheduled(BASE, known=READY).looks == {}
    assert scheduled(BASE, known=unproven, seen=()).looks == {}


def test_only_what_was_planned_or_is_waited_for_is_scheduled_anew():
    before = scheduled(PROBED, known=READY)
    planned = plan_all(situation(PROBED, seen=(box(),), known={"base": READY}))
    unplanned = replace(planned, replanned=())
    assert schedule(before, unplanned, {"base": 96.0}).targets.keys() == {("base", "ready")}
    asked = schedule(before, unplanned, {"base": 96.0})
    assert schedule(asked, unplanned, {}).targets == {}
    assert schedule(before, unplanned, {"gone": 96.0}).targets == {}
    other = replace(before, targets={("base", "live"): target_of(LIVE)})
    assert schedule(other, unplanned, {}).targets == other.targets, "nothing about it has changed"
    assert schedule(replace(other, engaged=True), unplanned, {}).targets == {}, "all is scheduled anew"
    assert schedule(other, replace(planned, replanned=("base",)), {}).targets == {}


def target_of(service: Service) -> Target:
    assert service.live is not None
    return Target(service.live, RUN, 2.0)
