"""What becomes of a service that nothing wants (rorg/core/idle.py), and what its pause would do to ROS peers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from situations import BASE, NOW, RUN, SPEC, box, situation, up

from rorg.core.idle import UNREPORTED, risks
from rorg.core.incremental import plan_all
from rorg.core.memory import Attempt, Progress
from rorg.core.ros_graph import RosGraph
from rorg.core.situation import Measures
from rorg.core.wanted import Cause
from rorg.model.catalog import Idle, Service
from rorg.model.engines import Capabilities

MASTER = "http://localhost:11311"
PAUSES = replace(BASE, idle=Idle(action="pause"))
ROS = replace(PAUSES, spec={**SPEC, "environment": {"ROS_MASTER_URI": MASTER}})
NODE = replace(BASE, idle=Idle(action="deactivate"), domain=0, managed=("/a", "/b"))


def does(service: Service, state: str = "running", **more: Any) -> tuple[list[str], list[float]]:
    """(verb and reason of each action, when to look again) of an unwanted service."""
    known = more.pop(
        "known", up(unwanted_since=NOW) if state == "running" else Progress(stopped=(RUN,), ceased_since=NOW)
    )
    seen = (box(state=state, spec=service.spec),)
    found = plan_all(situation(service, seen=seen, known={"base": known}, wanted={}, **more))
    alarm = found.plans["base"].alarm
    return [f"{a.verb}: {a.reason}" for a in found.plan().actions], [] if alarm is None else [alarm]


# -- the first step --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("idle", "done"),
    [
        (Idle(action="pause"), ["pause: not wanted"]),
        (Idle(action="stop"), ["stop: not wanted"]),
        (Idle(action="remove"), ["stop: not wanted", "remove: not wanted"]),
    ],
)
def test_a_service_idles_as_its_policy_says(idle, done):
    assert does(replace(BASE, idle=idle)) == (done, [])


def test_what_cannot_be_paused_is_stopped():
    why = "stop: not wanted; stop instead of pause: "
    assert does(PAUSES, engine=Capabilities(pause=False))[0] == [why + "the engine cannot pause"]
    twice = Attempt(count=2, error="unable to freeze")
    assert does(PAUSES, known=up(attempts={"pause": twice}))[0] == [why + "unable to freeze"]
    assert does(PAUSES, known=up(attempts={"pause": replace(twice, count=1)}))[0] == ["pause: not wanted"]
    never = replace(twice, count=1, unsupported=True)
    assert does(PAUSES, known=up(attempts={"pause": never}))[0] == [why + "unable to freeze"]
    assert does(PAUSES, known=up(attempts={"stop": twice}))[0] == ["pause: not wanted"]


def test_what_must_free_what_it_uses_is_stopped_even_if_it_is_paused():
    shed = Measures(shed=frozenset({"base"}))
    gone = {"measures": shed, "preempted": {"base": "shed under pressure"}}
    assert does(PAUSES, **gone)[0] == ["stop: shed under pressure"]
    assert does(PAUSES, "paused", **gone)[0] == ["stop: shed under pressure"]
    assert does(PAUSES, "exited", **gone)[0] == []


def test_paused_services_are_stopped_if_memory_is_short():
    short = {"measures": Measures(stop_paused=True)}
    assert does(PAUSES, "paused", **short)[0] == ["stop: the machine is short of memory"]
    assert does(PAUSES, "paused")[0] == []


# -- managed nodes ---------------------------------------------------------------------------------------------


def test_managed_nodes_are_deactivated_the_last_one_first():
    found = plan_all(situation(NODE, seen=(box(),), known={"base": up()}, wanted={})).plan()
    (action,) = found.actions
    assert (action.verb, action.operation.nodes, action.operation.domain) == ("deactivate", ("/b", "/a"), 0)
    for plain in (replace(NODE, managed=()), replace(NODE, domain=None)):
        assert does(plain)[0] == ["stop: not wanted"]


def test_nodes_that_nothing_reports_are_stopped_after_a_while():
    since = {"unreported": {"domain 0": NOW - 1.0}}
    graph = next(iter(since["unreported"]))
    for age, done, again in (
        (1.0, [], [NOW - 1.0 + UNREPORTED]),
        (UNREPORTED - 0.1, [], [NOW + 0.1]),
        (UNREPORTED, [f"stop: not wanted; stop instead of deactivate: nothing reports the graph of {graph}"], []),
    ):
        verbs, alarm = does(NODE, unreported={graph: NOW - age})
        assert verbs == done
        assert alarm == pytest.approx(again)
    failed = up(attempts={"deactivate": Attempt(count=2, error="a transition hangs")})
    assert does(NODE, known=failed)[0] == ["stop: not wanted; stop instead of deactivate: a transition hangs"]


# -- the second step -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("idle", "state", "after", "done", "again"),
    [
        (Idle(action="pause", escalate=(60.0, "stop")), "paused", 60.0, ["stop: not wanted for 60 s"], []),
        (Idle(action="pause", escalate=(60.0, "stop")), "paused", 59.0, [], [NOW + 1.0]),
        (Idle(action="pause", escalate=(60.0, "stop")), "exited", 60.0, [], []),
        (Idle(action="stop", escalate=(60.0, "remove")), "exited", 60.0, ["remove: not wanted for 60 s"], []),
        (Idle(action="stop", escalate=(60.0, "remove")), "exited", 59.0, [], [NOW + 1.0]),
        (Idle(action="deactivate", escalate=(60.0, "pause")), "inactive", 60.0, ["pause: not wanted for 60 s"], []),
        (Idle(action="deactivate", escalate=(60.0, "pause")), "inactive", 59.0, [], [NOW + 1.0]),
        (Idle(action="deactivate", escalate=(60.0, "pause")), "paused", 60.0, [], []),
    ],
)
def test_what_stays_unwanted_takes_a_second_step(idle, state, after, done, again):
    service = replace(NODE if idle.action == "deactivate" else BASE, idle=idle)
    known = Progress(stopped=(RUN,), ceased_since=NOW - after)
    assert does(service, state, known=known) == (done, again)


# -- peers in the graph of ROS 1 -------------------------------------------------------------------------------


def graph(**more: Any) -> dict[str, RosGraph]:
    nodes = {"/base": "base", "/nav": "nav", "/person": "", "/idle": "idle"}
    return {MASTER: RosGraph(**{"nodes": nodes, **more})}


HEARS = graph(subscribers={"/scan": ("/base",)}, publishers={"/scan": ("/nav",)})
MINDFUL = replace(ROS, idle=Idle(action="pause", connected="stop"))


def ends(service: Service, ros: Any, state: str = "running", wants: bool = True) -> list[str]:
    """What is done with an unwanted service, while `nav` is wanted or not."""
    known = {"base": up() if state == "running" else Progress(stopped=(RUN,), ceased_since=NOW)}
    more = {"seen": (box(state=state, spec=service.spec),), "known": known, "ros": ros}
    wanted = {"nav": (Cause("always_on"),)} if wants else {}
    plan = plan_all(situation(service, Service("nav", spec=SPEC), wanted=wanted, **more)).plan()
    return [f"{a.verb}: {a.reason}" for a in plan.actions if a.service == "base"]


def test_a_service_that_is_connected_is_stopped_if_its_manifest_says_so():
    connected = "not wanted; stop instead of pause: connected to nav by /scan"
    assert ends(MINDFUL, HEARS) == [f"stop: {connected}"]
    assert ends(ROS, HEARS) == ["pause: not wanted"]
    assert ends(MINDFUL, HEARS, wants=False) == ["pause: not wanted"], "nobody wants the other one"
    stranger = graph(subscribers={"/scan": ("/base",)}, publishers={"/scan": ("/person",)})
    assert ends(MINDFUL, stranger, wants=False) == [
        "stop: not wanted; stop instead of pause: connected to the node /person by /scan"
    ]
    unknown = "stop: not wanted; stop instead of pause: its connections in the ROS graph are not known"
    assert ends(MINDFUL, {}) == [unknown]
    assert ends(MINDFUL, {MASTER: RosGraph()}) == [unknown]


def test_a_paused_service_that_gets_connected_is_stopped():
    assert ends(MINDFUL, HEARS, "paused") == ["stop: stop instead of pause: connected to nav by /scan"]
    assert ends(ROS, HEARS, "paused") == []
    assert ends(MINDFUL, {}, "paused") == [], "it may be as when it was paused"


def told(service: Service, ros: Any, **more: Any) -> list[tuple[str, str]]:
    found = situation(service, Service("nav", spec=SPEC, always_on=True), ros=ros, **more)
    return [(risk.code, risk.message.split(";")[0]) for risk in risks(found, service)]


def test_the_risks_of_a_pause_are_told():
    many = {f"/s{n}": ("/base",) for n in range(5)}
    all_of_them = graph(
        subscribers={"/scan": ("/base",)},
        publishers={"/scan": ("/nav",), "/map": ("/base",)},
        providers={**many, "/base/get_loggers": ("/base",), "/nav/do": ("/nav",)},
    )
    blocks = "it subscribes to /scan of nav: a publisher may block while it is paused, and on resume it receives its"
    hangs = ("CallersHang", "it provides /s0, /s1, /s2 and 2 more: callers hang while it is paused")
    misses = "it publishes /map, usually only once: who subscribes while it is paused receives nothing"
    assert told(ROS, all_of_them) == [
        ("PublisherBlocks", f"{blocks} whole backlog"),
        hangs,
        ("LatchedTopicMissed", misses),
    ]
    assert told(MINDFUL, all_of_them) == [hangs], "it is not paused while it is connected"
    assert told(replace(ROS, always_on=True), all_of_them) == []
    assert told(replace(ROS, idle=Idle(action="stop")), all_of_them) == []
    assert told(ROS, all_of_them, engine=Capabilities(pause=False)) == []
    assert told(ROS, {}) == []
    assert told(ROS, graph(providers={"/base/set_logger_level": ("/base",)})) == []
    assert told(ROS, graph(publishers={"/scan": ("/base",)}, subscribers={"/scan": ("/nav",)})) == []
