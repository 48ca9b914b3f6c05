"""When a probe is asked again, and whether an answer is new enough for who waits for it."""

from __future__ import annotations

from dataclasses import replace

import pytest
from robots import VirtualRobot

from rorg.core.memory import ProbeResult, Progress, delay, together
from rorg.core.schedule import Schedule, Target, denied_since, told_since

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
    yes, no = ProbeResult("run", True, 5.0), ProbeResult("run", False, 3.0, "refused", 2)
    assert together(single, [no]) is no
    assert together(single, [None]) is None
    assert together(probe, [None, None]) is None
    assert together(probe, [yes, replace(yes, at=4.0)]) == ProbeResult("run", True, 4.0)
    assert together(probe, [yes, no]) == ProbeResult("run", False, 3.0, "refused", 2)
    assert together(probe, [no, no]) == no, "the same answer is told once"
    assert not together(probe, [yes, None]).ok
    assert together(probe, [yes, None]).message.endswith("has not answered yet")
