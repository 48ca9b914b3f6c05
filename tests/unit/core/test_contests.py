"""Who runs when not all can: conflicts, exclusive resources, holds and the budget, in every mixture."""

from __future__ import annotations

import pytest
from robots import VirtualRobot
from virtual_time import later

from rorg.core.requests import ProblemCode, problems
from rorg.model.catalog import Request

QUEUE = {"policy": {"budget": {"cpu": 1.0, "over": "queue"}}}


@pytest.fixture
def robot(tmp_path):
    return VirtualRobot(tmp_path)


def test_who_lost_to_a_loser_runs(robot):
    robot.declare(
        {
            "low": {"exclusive": ["camera0"], "priority": 10},
            "middle": {"exclusive": ["camera0", "gpu"], "priority": 50},
            "high": {"exclusive": ["gpu"], "priority": 90},
        }
    )
    robot.request("low", "middle", "high")
    robot.wait(lambda: robot.active() == {"low", "high"})
    assert robot.waits("middle") == "waits for gpu, which is taken by high"
    assert not robot.waits("low")


def test_losers_come_back_by_rank(robot):
    """Both lost to `middle`, which loses itself; they cannot both run either."""
    robot.declare(
        {
            "aa": {"conflicts": ["bb", "middle"], "priority": 10},
            "bb": {"conflicts": ["middle"], "priority": 20},
            "middle": {"exclusive": ["gpu"], "priority": 50},
            "high": {"exclusive": ["gpu"], "priority": 90},
        }
    )
    robot.request("aa", "bb", "middle", "high")
    robot.wait(lambda: robot.active() == {"bb", "high"})


def test_a_requester_does_not_give_way_to_what_it_asks_for(robot):
    robot.declare(
        {"mission": {"always_on": True, "exclusive": ["gpu"]}, "track": {"exclusive": ["gpu"]}},
        requests={"standing": {"requester": "mission", "services": ["track"], "priority": 90}},
    )
    robot.wait(lambda: robot.active() == {"mission"})
    later(robot, 10)
    assert robot.active() == {"mission"}
    assert "taken by mission, for which it was requested" in robot.waits("track")
    assert sum("start mission" in line for line in robot.log()) == 1


def test_a_request_that_its_requester_rules_out_is_refused(robot):
    robot.declare({"mission": {"exclusive": ["gpu"]}, "track": {"exclusive": ["gpu"]}})
    catalog = robot.sim.desired.catalog
    (problem,) = problems(catalog, (), Request("look", "mission", ("track",)))
    assert problem.code == ProblemCode.RESOURCES
    assert problem.cause == "it does not fit: mission, track use 2 of 1 gpu"
    assert problems(catalog, (), Request("look", "developer", ("track",))) == []


def test_what_gives_way_takes_no_room(robot):
    robot.declare(
        {
            "aa": {"resources": {"cpu": 0.8}, "exclusive": ["gpu"], "priority": 50},
            "bb": {"resources": {"cpu": 0.8}, "priority": 40},
            "cc": {"exclusive": ["gpu"], "priority": 90},
        },
        policies=QUEUE,
    )
    for name in ("aa", "bb", "cc"):
        robot.request(name, id=name)
    robot.wait(lambda: robot.active() == {"bb", "cc"})
    robot.release("cc")
    robot.wait(lambda: robot.active() == {"aa"})
    assert "waits for room" in robot.waits("bb")


def test_what_is_held_and_what_waits_for_it_take_no_room(robot):
    robot.declare(
        {
            "map": {},
            "nav": {"resources": {"cpu": 0.8}, "needs": ["map"], "priority": 50},
            "log": {"resources": {"cpu": 0.8}, "priority": 40},
        },
        policies=QUEUE,
    )
    robot.request("nav", id="nav")
    robot.request("log", id="log")
    robot.hold("map", 30.0)
    robot.wait(lambda: robot.active() == {"log"})
    robot.wait(lambda: robot.active() == {"map", "nav"})


def test_a_meta_service_does_not_give_way(robot):
    robot.declare(
        {
            "shift": {"type": "meta", "needs": ["detect"]},
            "detect": {"exclusive": ["gpu"]},
            "train": {"exclusive": ["gpu"], "priority": 90},
            "arm": {},
        },
        requests={"work": {"requester": "shift", "services": ["arm"]}},
    )
    robot.wait(lambda: robot.active() == {"detect", "arm"})
    before = robot.container("arm").incarnation
    robot.request("train")
    robot.wait(lambda: robot.active() == {"train", "arm"})
    robot.release()
    robot.hold("detect", 20.0)
    later(robot, 10)
    assert robot.active() == {"arm"}
    assert robot.container("arm").incarnation == before


def test_queued_requests_keep_their_place_when_they_are_renewed(robot):
    robot.declare({n: {"resources": {"cpu": 0.6}} for n in ("aa", "bb")}, policies=QUEUE)
    robot.request("aa", id="aa", ttl=10.0)
    robot.request("bb", id="bb", ttl=10.0)
    for n in range(4):
        later(robot, 2)
        robot.request("aa", id="aa", ttl=10.0, renewed=f"{n}")
        later(robot, 2)
        robot.request("bb", id="bb", ttl=10.0, renewed=f"{n}")
    assert robot.active() == {"aa"}
    assert sum("> start" in line for line in robot.log()) == 1


def test_a_priority_is_that_of_the_request_that_says_it(robot):
    """A standing request and a live one may have the same id."""
    robot.declare({"cam": {}, "log": {}}, requests={"work": {"services": ["cam"], "priority": 95}})
    robot.request("log", id="work", priority=5)
    robot.wait(lambda: robot.active() == {"cam", "log"})
    ranks = robot.sim.decision.situation.priorities
    assert (ranks["cam"], ranks["log"]) == (95, 50)


def test_an_idle_holder_keeps_its_place_where_there_is_room(robot):
    robot.declare(
        {
            "job": {"exclusive": ["gpu"], "restart": "never"},
            "vision": {"exclusive": ["gpu"], "idle": {"action": "pause", "linger": "30s"}},
        },
        policies={"policy": {"resources": {"gpu": 2}}},
    )
    robot.request("job", id="job")
    robot.request("vision", id="vision")
    robot.wait(lambda: len(robot.active()) == 2)
    robot.kill("job")
    robot.release("vision")
    later(robot, 10)
    assert robot.active() == {"vision"}
    later(robot, 30)
    assert robot.states()["vision"] == "paused"


def test_a_hold_of_what_cannot_be_ceased_is_nothing(robot):
    robot.declare({"cam": {}})
    robot.request("cam")
    robot.wait(lambda: robot.active() == {"cam"})
    for name in ("developer", "nobody"):
        robot.hold(name, 5.0)
        later(robot, 2)
    assert robot.active() == {"cam"}


ARM = {"always_on": True}


@pytest.mark.parametrize("rule", ["exclusive", "conflicts"])
@pytest.mark.parametrize("fate", ["renamed", "meta"])
def test_nothing_begins_beside_what_no_manifest_declares_any_more(robot, rule, fate):
    """A manifest was renamed: the new arm waits until the old one has ended."""
    rules = {"exclusive": ["can0"]} if rule == "exclusive" else {}
    robot.declare({"old": {**ARM, **rules}, "new": {**rules, **({} if rules else {"conflicts": ["old"]})}})
    robot.settle()
    robot.sim.faults.hang["stop", "old"] = 5.0
    robot.declare({"new": {**ARM, **rules}, **({"old": {"type": "meta"}} if fate == "meta" else {})})
    robot.wait(lambda: "new" in robot.active(), 20)
    assert robot.states() == {"new": "running"}


def test_nor_beside_what_may_not_be_touched(robot):
    robot.declare({"old": {**ARM, "exclusive": ["can0"], "interlock": {"file": "/allow"}}})
    robot.settle()
    robot.sim.locked = {"old"}
    robot.declare({"new": {**ARM, "exclusive": ["can0"]}})
    later(robot, 20)
    assert robot.active() == {"old"}
    assert "waits for can0, which old still uses" in robot.waits("new")
    robot.sim.locked = set()
    robot.wait(lambda: robot.active() == {"new"})


def test_a_loser_lets_go_when_there_is_less_than_before(robot):
    tree = {"aa": {"exclusive": ["cam"], "priority": 90}, "bb": {"exclusive": ["cam"], "idle": {"action": "pause"}}}
    robot.declare(tree, policies={"policy": {"resources": {"cam": 2}}})
    robot.request("aa", "bb")
    robot.wait(lambda: len(robot.active()) == 2)
    robot.declare(tree, policies={"policy": {"resources": {"cam": 1}}})
    robot.wait(lambda: robot.states() == {"aa": "running", "bb": "exited"})


def test_what_is_held_does_not_linger(robot):
    robot.declare({"arm": {"idle": {"linger": "10m"}}})
    robot.request("arm")
    robot.wait(lambda: robot.active() == {"arm"})
    robot.release()
    later(robot, 1)
    robot.hold("arm", 300.0, "somebody is in the cell")
    robot.wait(lambda: robot.active() == set(), 2)


@pytest.mark.parametrize("rival", [{"conflicts": ["map"]}, {"exclusive": ["gpu"]}, None])
def test_nor_does_what_needs_something_that_must_go(robot, rival):
    robot.declare(
        {
            "map": {"exclusive": ["gpu"]},
            "nav": {"needs": ["map"], "idle": {"linger": "10m"}},
            "rival": {"priority": 99, **(rival or {})},
        }
    )
    robot.request("nav")
    robot.wait(lambda: robot.active() == {"map", "nav"})
    robot.release()
    later(robot, 1)
    assert "nav" in robot.active()
    if rival is None:
        robot.hold("map", 300.0)
        robot.wait(lambda: robot.active() == set(), 2)
    else:
        robot.request("rival", id="rival")
        robot.wait(lambda: robot.active() == {"rival"}, 2)
