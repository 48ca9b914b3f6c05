"""What an operation would change: the difference between two decisions of the planner."""

from __future__ import annotations

from dataclasses import replace

import pytest
from robots import VirtualRobot

from rorg.core.consequences import Consequences, Effect, Preempted, consequences
from rorg.core.holds import begin_hold
from rorg.model.catalog import Request
from rorg.model.units import stamp

ROBOT = {
    "core": {"always_on": True},
    "camera": {"needs": ["core"], "exclusive": ["hand"], "priority": 80, "idle": {"linger": "0s"}},
    "detector": {"needs": ["camera"], "idle": {"linger": "0s"}},
    "teleop": {"needs": ["core"], "exclusive": ["hand"], "idle": {"action": "pause", "linger": "0s"}},
    "slow": {"idle": {"linger": "20s"}},
    "map": {"idle": {"action": "pause", "linger": "0s"}},
    "tour": {"may_request": ["map"], "idle": {"linger": "0s"}},
    "arm": {"needs": [{"service": "core", "restart": True}], "idle": {"linger": "0s"}},
}


@pytest.fixture
def robot(tmp_path):
    robot = VirtualRobot(tmp_path)
    robot.declare(ROBOT, groups={"seeing": {"services": ["detector", "map"]}})
    robot.wait(lambda: "core" in robot.active())
    robot.settle()
    return robot


def would(robot, edit) -> Consequences:
    """What an edit of the requests file would change; nothing of it is done."""
    before, document = robot.sim.inputs(), robot.sim.document
    robot.change(edit)
    changed = robot.sim.inputs()
    robot.sim.document = document
    return consequences(before, changed)


def requested(*services: str, id: str = "new"):
    return lambda asked: asked.put(Request(id, "developer", services))


def released(id: str):
    return lambda asked: asked.without({("developer", id)})


def restarted(robot, name: str):
    return lambda asked: replace(asked, restarts={name: stamp(robot.wall())})


def held(robot, name: str):
    return lambda asked: replace(asked, holds={name: begin_hold(robot.moment(), 600, "cleaning")})


def suspended(robot):
    return lambda asked: replace(asked, suspended=begin_hold(robot.moment(), 600, "cleaning"))


def bring_up(robot, *services: str, id: str, by: str = "developer") -> None:
    robot.request(*services, id=id, by=by)
    robot.wait(lambda: set(services) <= robot.active() and at_rest(robot))


def at_rest(robot) -> bool:
    """Whether nothing is under way and nothing is left to do; what waits may go on waiting."""
    return not (robot.sim.memory.in_flight or robot.sim.decision.plan.actions)


def test_a_request_starts_a_group_with_its_needs(robot):
    found = would(robot, requested("seeing"))
    assert found.of(Effect.START) == ["camera", "detector", "map"]
    assert found.wanted == ("camera", "detector", "map")
    assert (found.unwanted, found.preempted, found.waits) == ((), (), ())
    assert robot.active() == {"core"}, "nothing is done"


def test_a_request_for_what_is_wanted_already_changes_nothing(robot):
    bring_up(robot, "detector", id="first")
    assert would(robot, requested("camera")) == Consequences({}, (), (), (), ())


def test_who_gives_way_is_named_with_its_winner(robot):
    bring_up(robot, "teleop", id="drive")
    found = would(robot, requested("camera"))
    assert found.effects == {"camera": Effect.START, "teleop": Effect.STOP}
    (loser,) = found.preempted
    assert (loser.service, loser.by) == ("teleop", ("camera",))
    assert "hand" in loser.reason


def test_what_loses_itself_says_to_whom(robot):
    bring_up(robot, "camera", id="see")
    found = would(robot, requested("teleop"))
    assert found.effects == {}
    assert found.preempted == (Preempted("teleop", ("camera",), "waits for hand, which is taken by camera"),)
    assert found.wanted == ("teleop",)


def test_the_end_of_a_request_lets_in_what_gave_way_to_it(robot):
    bring_up(robot, "teleop", id="drive")
    bring_up(robot, "camera", id="see")
    found = would(robot, released("see"))
    assert found.unwanted == ("camera",)
    assert found.effects == {"camera": Effect.STOP, "teleop": Effect.START}


def test_an_idle_service_resumes_and_a_released_one_pauses(robot):
    bring_up(robot, "map", id="m")
    assert would(robot, released("m")).effects == {"map": Effect.PAUSE}
    robot.release("m")
    robot.wait(lambda: robot.states()["map"] == "paused")
    assert would(robot, requested("map")).effects == {"map": Effect.RESUME}


def test_always_on_services_stay_whatever_is_released(robot):
    bring_up(robot, "arm", id="a")
    found = would(robot, released("a"))
    assert (found.unwanted, found.effects) == (("arm",), {"arm": Effect.STOP})


def test_a_lingering_service_is_unwanted_and_says_how_long_it_stays(robot):
    bring_up(robot, "slow", id="s")
    found = would(robot, released("s"))
    assert (found.effects, found.unwanted) == ({}, ("slow",))
    assert [(w.service, w.reason) for w in found.waits] == [("slow", "lingers for 20 s")]
    robot.release("s")
    robot.sim.step()
    kept = would(robot, requested("slow"))
    assert (kept.effects, kept.wanted) == ({}, ("slow",)), "it runs, and stays"


def test_a_restart_takes_along_what_restarts_with_it_and_ends_the_requests_of_its_run(robot):
    bring_up(robot, "arm", "tour", id="t")
    assert would(robot, restarted(robot, "core")).of(Effect.RESTART) == ["arm", "core"]
    bring_up(robot, "map", id="mine", by="tour")
    found = would(robot, restarted(robot, "tour"))
    assert found.effects == {"map": Effect.PAUSE, "tour": Effect.RESTART}
    assert found.unwanted == ("map",), "its request ends with the run that sent it"


def test_a_hold_keeps_out_what_needs_the_service_and_its_end_lets_it_in(robot):
    bring_up(robot, "detector", id="see")
    found = would(robot, held(robot, "camera"))
    assert found.effects == {"camera": Effect.STOP, "detector": Effect.STOP}
    assert [(p.service, p.by) for p in found.preempted] == [("camera", ()), ("detector", ())]
    robot.change(held(robot, "camera"))
    robot.wait(lambda: robot.active() == {"core"} and at_rest(robot))
    back = would(robot, lambda asked: replace(asked, holds={}))
    assert back.effects == {"camera": Effect.START, "detector": Effect.START}


def test_while_rorg_is_suspended_everything_waits_and_then_it_goes_on(robot):
    assert would(robot, suspended(robot)) == Consequences({}, (), (), (), ())
    robot.change(suspended(robot))
    robot.sim.step()
    found = would(robot, requested("map"))
    assert (found.effects, found.wanted) == ({}, ("map",))
    ((service, code),) = [(w.service, w.code) for w in found.waits]
    assert (service, code) == ("map", "suspended")
    robot.change(requested("map"))
    robot.sim.step()
    on = would(robot, lambda asked: replace(asked, suspended=None))
    assert on.effects == {"map": Effect.START}


def test_while_the_engine_is_silent_nothing_is_said_to_happen(robot):
    bring_up(robot, "arm", id="a")
    robot.sim.faults.unreachable = True
    robot.sim.step()
    found = would(robot, requested("map"))
    assert (found.effects, found.wanted) == ({}, ("map",))
    assert [(w.service, w.reason) for w in found.waits] == [("map", "the engine does not answer")]
    gone = would(robot, released("a"))
    assert (gone.effects, gone.unwanted) == ({}, ("arm",))


def test_an_interlock_is_asked_first_and_says_nothing_before(robot):
    robot.declare({**ROBOT, "gripper": {"interlock": {"file": "/allow"}, "idle": {"linger": "0s"}}})
    robot.settle()
    robot.sim.locked = {"gripper"}
    found = would(robot, requested("gripper"))
    assert (found.effects, found.interlocked) == ({"gripper": Effect.START}, ("gripper",))


def test_a_retry_replaces_the_container_once_more(robot):
    bring_up(robot, "slow", id="s")
    broken = {**ROBOT, "slow": {**ROBOT["slow"], "command": ["other"], "ready": {"file": "/never", "timeout": "5s"}}}
    robot.sim.ready_after = {"slow": 1e6}
    robot.declare(broken, groups={"seeing": {"services": ["detector", "map"]}})
    robot.wait(lambda: robot.sim.memory.of("slow").update.failed and at_rest(robot), 120)
    found = would(robot, lambda asked: replace(asked, retries={"slow": stamp(robot.wall())}))
    assert found.effects == {"slow": Effect.RESTART}
