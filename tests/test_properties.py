"""Invariants over random robots, requests, crashes and drift, in virtual time."""

from __future__ import annotations

import contextlib
import tempfile
from pathlib import Path

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from robots import write_tree

from rorg.core.requests import problems
from rorg.core.wanted import wanted
from rorg.errors import RorgError
from rorg.manifest.catalog import Request
from rorg.manifest.load import load_or_raise
from rorg.sim.robot import SimRobot

NAMES = [f"s{n}" for n in range(6)]


@st.composite
def catalogs(draw):
    """Trees without cycles: a service needs only earlier ones."""
    services = {}
    for index, name in enumerate(NAMES):
        services[name] = {
            "needs": draw(st.lists(st.sampled_from(NAMES[:index]), max_size=2, unique=True)) if index else [],
            "always_on": draw(st.integers(0, 5)) == 0,
            "idle": {"action": draw(st.sampled_from(["pause", "stop", "remove"])),
                     "linger": draw(st.sampled_from(["0s", "1s", "5s"]))},
            "ready": draw(st.sampled_from([{"delay": "300ms"}, {"tcp": 1234}])),
        }
    return services


EVENTS = st.lists(st.tuples(
    st.sampled_from(["request", "release", "kill", "pause", "hang", "request_as", "replace"]),
    st.sampled_from(NAMES), st.floats(0, 3, allow_nan=False)), max_size=14)


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(catalogs(), EVENTS)
def test_every_robot_ends_up_as_asked(specs, events):
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        catalog = load_or_raise(write_tree(root, specs))
        robot = SimRobot(catalog)
        time = 0.0
        for verb, name, pause in events:
            time += pause
            robot.at(time, lambda verb=verb, name=name: disturb(robot, verb, name, specs, root))
        robot.run(lambda r: check_order(r) and r.now >= time and r.idle, 900.0)
        found = wanted(robot.desired.catalog, (*catalog.requests, *robot.asked.requests))
        assert robot.active() == {n for n in found if n != "developer"}
        for name, state in robot.states().items():
            if name not in found:
                action = specs[name]["idle"]["action"]
                assert state in {"pause": ("paused", "created", "exited"), "stop": ("created", "exited"),
                                 "remove": ()}[action], (name, state)
        assert len(robot.engine.list()) == len(robot.states()), "two containers of a service"
        alive = {c.incarnation for c in robot.engine.list() if c.alive}
        assert all(r.incarnation in alive for r in robot.asked.requests if r.requester != "developer")


def disturb(robot: SimRobot, verb: str, name: str, specs: dict, root: Path) -> None:
    """Something that happens to a robot. What is impossible at the moment does not happen."""
    containers = {c.service: c for c in robot.engine.list()}
    current = containers.get(name)
    if verb == "request" and not problems(robot.desired.catalog, robot.asked.requests,
                                          Request(name, "developer", (name,))):
        robot.asked = robot.asked.put(Request(name, "developer", (name,)))
    elif verb == "release":
        robot.asked = robot.asked.without({("developer", name)})
    elif verb == "request_as" and current and current.alive:
        other = NAMES[(NAMES.index(name) + 3) % len(NAMES)]
        robot.asked = robot.asked.put(Request("r", name, (other,), incarnation=current.incarnation))
    elif verb == "kill" and current and current.alive:
        robot.engine.kill(current.id)
    elif verb == "pause" and current and current.state == "running":
        with contextlib.suppress(RorgError):
            robot.engine.pause(current.id)
    elif verb == "hang":
        robot.faults.hang["start", name] = 10.0
    elif verb == "replace":
        specs[name]["container"] = {"environment": {"N": str(robot.now)}}
        robot.declare(load_or_raise(write_tree(root, specs)))


def check_order(robot: SimRobot) -> bool:
    """A start that was just begun had all it needs ready."""
    for name, flight in robot.memory.in_flight.items():
        if flight.action.verb in ("start", "resume") and flight.since == robot.now:
            for need in robot.desired.catalog.services[name].needs:
                assert robot.memory.of(need).ready, f"{name} was begun before {need} was ready"
    return True
