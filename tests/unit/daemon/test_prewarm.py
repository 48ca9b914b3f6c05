"""Services that are made active before they are requested."""

from __future__ import annotations

import pytest
from habits import AUTO, habits
from robots import VirtualRobot, write_tree

from rorg.core.prediction import learn
from rorg.errors import Invalid
from rorg.manifest.effective import effective
from rorg.manifest.load import load_or_raise
from rorg.model.learned import Departure, Learned
from rorg.model.trace import TraceEvent
from rorg.store.learned_file import NAME, read_learned, write_learned


@pytest.fixture
def robot(tmp_path):
    return VirtualRobot(tmp_path)


def begin(robot: VirtualRobot, services: dict, learned: Learned | None, **kinds: dict) -> None:
    """A robot at rest, of which `ears` is requested at once."""
    robot.declare({"ears": {}, **services}, **kinds)
    robot.sim.learned = learned
    robot.settle()
    robot.request("ears")


def prewarmed(robot: VirtualRobot) -> set[str]:
    return set(robot.sim.decision.situation.prewarmed)


def never(robot: VirtualRobot, name: str, seconds: float = 90.0) -> bool:
    """It does not become active in this time."""
    end, seen = robot.now() + seconds, []
    robot.sim.at(end, lambda: None)
    robot.wait(lambda: seen.append(robot.active()) or robot.now() >= end, seconds + 1)
    return not any(name in names for names in seen)


def test_it_runs_when_the_request_comes(robot):
    begin(robot, {"wheels": AUTO}, habits(("wheels", 60.0)))
    asked = robot.now()
    robot.wait(lambda: "wheels" in robot.active(), 70)
    assert 50 < robot.now() - asked < 60
    run = robot.run_of("wheels")
    cause = robot.sim.decision.situation.wanted["wheels"][0]
    assert (cause.kind, cause.by) == ("prewarmed", "developer")
    assert str(cause) == "prewarmed: developer asks for it within 3.0 s in 91% of cases"
    robot.wait(lambda: robot.sim.memory.of("wheels").ready)
    robot.request("wheels")
    robot.wait(lambda: not prewarmed(robot) and robot.sim.idle)
    assert robot.run_of("wheels") == run
    assert sum("start wheels" in line for line in robot.log()) == 1


def test_off_is_the_default(robot):
    begin(robot, {"wheels": {"idle": {"action": "pause"}}}, habits(("wheels", 60.0)))
    assert never(robot, "wheels")


def test_what_is_unlikely_stays_idle(robot):
    begin(
        robot,
        {"wheels": AUTO},
        habits(*[("lamp", 60.0)] * 8, ("wheels", 60.0)),
    )
    assert never(robot, "wheels")


def test_a_probability_of_its_own(robot):
    services = {"wheels": {"idle": {"action": "pause", "prewarm": 0.05}}, "lamp": {}}
    begin(robot, services, habits(*[("lamp", 60.0)] * 8, ("wheels", 60.0)))
    robot.wait(lambda: "wheels" in robot.active(), 70)


def test_it_is_given_up_when_the_request_does_not_come(robot):
    begin(
        robot, {"wheels": {"idle": {"action": "pause", "prewarm": "auto", "linger": "30s"}}}, habits(("wheels", 20.0))
    )
    robot.wait(lambda: "wheels" in robot.active(), 30)
    since = robot.now()
    robot.wait(lambda: "wheels" not in robot.active(), 60)
    assert robot.now() - since < 15, "nobody has used it, so it does not linger"
    assert never(robot, "wheels")


def test_what_it_needs_comes_first_and_what_moves_something_never(robot):
    services = {
        "map": {},
        "wheels": {**AUTO, "needs": ["map"]},
        "arm": {**AUTO, "interlock": {"file": "/allow"}},
        "hand": {**AUTO, "needs": ["arm"]},
        "gpu": {**AUTO, "exclusive": ["gpu"]},
    }
    departures = tuple(Departure(60.0, ("gpu", "hand", "wheels")) for _ in range(10))
    begin(robot, services, Learned({"developer": {("ears",): departures}}))
    robot.wait(lambda: robot.sim.memory.of("wheels").ready, 70)
    assert robot.active() == {"ears", "map", "wheels"}
    assert prewarmed(robot) == {"map", "wheels"}


def test_a_conflict_is_never_taken(robot):
    services = {"wheels": {**AUTO, "conflicts": ["dock"]}, "dock": {}}
    begin(robot, services, habits(("wheels", 60.0), ("dock", 90.0)))
    assert never(robot, "wheels")


def test_never_without_room(robot):
    services = {"ears": {"resources": {"cpu": 1.0}}, "wheels": {**AUTO, "resources": {"cpu": 1.5}}}
    begin(robot, services, habits(("wheels", 60.0)), policies={"policy": {"budget": {"cpu": 2.0}}})
    assert never(robot, "wheels")


def test_never_under_pressure(robot):
    limits = {"policy": {"budget": {"cpu": 2.0}, "pressure": {"step": "500ms"}}}
    services = {"ears": {"resources": {"cpu": 1.0}}, "wheels": {**AUTO, "resources": {"cpu": 0.5}}}
    begin(robot, services, habits(("wheels", 60.0)), policies=limits)
    robot.wait(lambda: "wheels" in robot.active(), 70)
    robot.sim.extra = (1.5, 0)
    robot.wait(lambda: robot.sim.memory.pressure.engaged and "wheels" not in robot.active(), 5)
    assert not prewarmed(robot)


def test_one_that_ends_by_itself_is_left_alone(robot):
    begin(robot, {"wheels": {**AUTO, "restart": "never"}}, habits(("wheels", 60.0)))
    robot.sim.faults.crash_after["wheels"] = 0.5
    robot.wait(lambda: "wheels" in robot.active(), 70)
    robot.wait(lambda: "wheels" not in robot.active(), 10)
    assert never(robot, "wheels")
    robot.sim.faults.crash_after.clear()
    robot.request("wheels")
    robot.wait(lambda: robot.sim.memory.of("wheels").ready, 5)


def test_how_long_it_takes_is_measured(robot):
    ready = {"ready": {"tcp": 1234}}
    begin(robot, {"wheels": {**AUTO, **ready}}, habits(("wheels", 60.0)))
    robot.sim.ready_after["wheels"] = 8.0
    robot.request("wheels", id="try")
    robot.wait(lambda: robot.sim.memory.of("wheels").ready)
    robot.release("try")
    robot.wait(lambda: "wheels" not in robot.active())
    took = robot.sim.memory.prediction.learned.took["wheels"]
    assert took["start"] == pytest.approx(8.1, abs=0.1)


def test_a_robot_goes_on_learning(robot):
    events = [TraceEvent(n * 100.0, "developer", "r", ("ears",) if n % 2 else ()) for n in range(20)]
    begin(robot, {"wheels": AUTO}, learn(events))
    for _ in range(6):
        robot.wait(lambda: "ears" in robot.active())
        robot.sim.at(robot.now() + 30.0, lambda: robot.request("wheels"))
        robot.wait(lambda: "wheels" in robot.active() and not prewarmed(robot), 40)
        robot.sim.at(robot.now() + 30.0, lambda: robot.request("ears"))
        robot.wait(lambda: robot.active() == {"ears"}, 40)
    robot.wait(lambda: prewarmed(robot) == {"wheels"}, 30)


def test_the_policy_is_for_all_but_drivers(tmp_path):
    idle = {"prewarm": "auto"}
    specs = {
        "ears": {},
        "wheels": {"driver": {}},
        "lamp": {"driver": {}, "idle": idle},
        "map": {"idle": {"prewarm": "off"}},
        "door": {"idle": {"prewarm": 0.6}},
    }
    tree = write_tree(tmp_path, specs, policies={"policy": {"idle": idle}})
    services = load_or_raise(tree).services
    found = {n: services[n].idle.prewarm for n in specs}
    assert found == {"ears": 0.2, "wheels": 0.0, "lamp": 0.2, "map": 0.0, "door": 0.6}
    told = {n: [(v.text, v.kind) for v in effective(tree, n) if v.field == "idle.prewarm"] for n in specs}
    assert told["ears"] == [("auto", "policy")]
    assert told["wheels"] == []
    assert told["lamp"] == [("auto", "manifest")]


@pytest.mark.parametrize("said", ["always", 0, 1.5, True])
def test_what_is_no_probability_is_refused(tmp_path, said):
    with pytest.raises(Invalid, match=r"services/ears.yaml:\d+:\d+"):
        load_or_raise(write_tree(tmp_path, {"ears": {"idle": {"prewarm": said}}}))


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", '{"version": 2}', '{"version": 1, "departures": {"a": [{"asked": "b"}]}, "took": {}}'],
)
def test_what_cannot_be_understood_is_passed_over(tmp_path, text):
    (tmp_path / NAME).write_text(text)
    assert read_learned(tmp_path) is None


def test_what_was_learnt_is_read_as_it_was_written(tmp_path):
    learned = Learned(habits(("wheels", 6.0)).departures, {"wheels": {"start": 1.5}})
    write_learned(tmp_path, learned)
    assert read_learned(tmp_path) == learned
