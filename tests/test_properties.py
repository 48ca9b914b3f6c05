"""Invariants over random robots, requests, crashes, drift, people and load, in virtual time.

Every pass is checked (see `invariants`), and so is the state in which the robot comes to rest.
"""

from __future__ import annotations

import contextlib
import tempfile
from dataclasses import replace
from pathlib import Path

from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from robots import write_tree

from rorg.core.arbitrate import PROTECTED
from rorg.core.observed import Container
from rorg.core.requests import problems
from rorg.errors import RorgError
from rorg.manifest.catalog import Hold, Request
from rorg.manifest.load import load_or_raise
from rorg.manifest.references import closure
from rorg.sim.robot import SimRobot

NAMES = [f"s{n}" for n in range(6)]
QUIET = 100.0
"""Seconds at the end of every run in which nothing may happen any more."""
REST = 200.0
"""Seconds after the last disturbance; longer than every linger, lease, hold and time of calm together."""


@st.composite
def services(draw):
    """Trees without cycles: a service needs only earlier ones."""
    found = {}
    for index, name in enumerate(NAMES):
        needs = draw(st.lists(st.sampled_from(NAMES[:index]), max_size=2, unique=True)) if index else []
        idle = {"action": draw(st.sampled_from(["pause", "stop", "remove"])),
                "linger": draw(st.sampled_from(["0s", "1s", "5s"])),
                "min_active": draw(st.sampled_from(["0s", "2s"]))}
        if draw(st.integers(0, 2)) == 0:
            idle["escalate"] = {"after": "3s", "action": "stop"}
        found[name] = {
            "needs": [{"service": n, "restart": True} if draw(st.booleans()) else n for n in needs],
            "always_on": draw(st.integers(0, 5)) == 0, "idle": idle,
            "ready": draw(st.sampled_from([{"delay": "300ms"}, {"tcp": 1234}])),
            "live": draw(st.sampled_from([None, {"tcp": 1234}])),
            "priority": draw(st.sampled_from([20, 50, 80])), "protected": draw(st.integers(0, 4)) == 0,
            "exclusive": draw(st.sampled_from([[], [], ["gpu"]])),
            "resources": {"cpu": draw(st.sampled_from([0.1, 0.5])), "memory": draw(st.sampled_from(["1Mi", "1Gi"]))},
        }
        found[name] = {k: v for k, v in found[name].items() if v is not None}
    return found


POLICIES = st.sampled_from([
    {}, {"budget": {"cpu": 1.2, "over": "queue"}},
    {"budget": {"cpu": 2.0, "memory": "4Gi"}, "pressure": {"step": "2s", "calm": "4s", "admit": 30}},
    {"budget": {"cpu": 1.5, "over": "queue"}, "pressure": {"step": "1s", "calm": "2s"}, "resources": {"gpu": 2}},
])
EVENTS = st.lists(st.tuples(
    st.sampled_from(["request", "lease", "release", "kill", "pause", "hang", "freeze", "request_as", "replace", "hold",
                     "suspend", "load", "unload"]),
    st.sampled_from(NAMES), st.floats(0, 3, allow_nan=False)), max_size=14)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(services(), POLICIES, EVENTS)
def test_every_robot_comes_to_rest_as_asked(specs, policy, events):
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        catalog = load_or_raise(write_tree(root, specs, policies={"policy": policy}))
        robot = SimRobot(catalog)
        time = 0.0
        for verb, name, pause in events:
            time += pause
            robot.at(time, lambda verb=verb, name=name: disturb(robot, verb, name, specs, root, policy))
        robot.at(time + REST, lambda: None)
        robot.run(lambda r: invariants(r) and r.now >= time + REST, time + 2 * REST)
        at_rest(robot, specs)


def at_rest(robot: SimRobot, specs: dict) -> None:
    situation = robot.decision.situation
    late = [call for call in robot.engine.calls if call[0] > robot.now - QUIET]
    assert not late, f"it does not come to rest: {late[:6]}"
    wanted = {n for n in situation.wanted if n != "developer"}
    waiting = {w.service for w in robot.decision.plan.waitings}
    assert robot.active() <= wanted
    assert wanted - robot.active() <= waiting, "wanted is served or explained"
    if not robot.memory.pressure.level:
        assert robot.active() == wanted
    for name, state in robot.states().items():
        if name not in situation.wanted:
            idle = specs[name]["idle"]
            allowed = {"pause": ("paused", "created", "exited"), "stop": ("created", "exited"), "remove": ()}
            assert state in allowed[idle["action"]], (name, state)
            assert not (state == "paused" and "escalate" in idle), f"{name} was never stopped"
    assert len(robot.engine.list()) == len(robot.states()), "two containers of a service"
    for resource in ("gpu",):
        holders = [n for n, s in robot.states().items() if s in ("running", "paused") and specs[n]["exclusive"]]
        wanted_holders = [n for n in holders if n in situation.wanted]
        assert len(wanted_holders) <= robot.desired.catalog.policy.resources.get(resource, 1)


def invariants(robot: SimRobot) -> bool:
    """Of one pass."""
    decision, services = robot.decision, robot.desired.catalog.services
    situation = decision.situation
    told = {a.service for a in decision.plan.actions} | {w.service for w in decision.plan.waitings} | {
        *robot.memory.in_flight}
    states = robot.states()
    for name in situation.wanted:
        assert services[name].meta or states.get(name) == "running" or name in told, f"{name} is not explained"
    for name in robot.active():
        assert name in situation.wanted or name in told, f"{name} runs though nobody wants it"
    for name, flight in robot.memory.in_flight.items():
        if flight.action.verb in ("start", "resume") and flight.since == robot.now:
            assert not situation.suspended and name not in decision.holds
            for need in services[name].needs:
                assert robot.memory.of(need).ready, f"{name} was begun before {need} was ready"
            for resource in services[name].exclusive:
                alive = [c for c in robot.engine.list() if c.alive and c.service != name
                         and resource in services[c.service].exclusive]
                assert len(alive) < robot.desired.catalog.policy.resources.get(resource, 1), "more than there are"
    alive = {c.incarnation for c in robot.engine.list() if c.alive}
    assert all(r.incarnation in alive for r in decision.settled.requests if r.requester != "developer")
    shed_well(robot)
    return True


def shed_well(robot: SimRobot) -> None:
    """What was shed just now mattered least of all that could be shed, and no more important request held it."""
    situation, state = robot.decision.situation, robot.memory.pressure
    if not state.shed or state.changed_at != robot.now:
        return
    services, shed = robot.desired.catalog.services, state.shed[-1].service
    assert not services[shed].protected
    for name in situation.wanted:
        assert shed not in services[name].needs, f"{name} needs {shed}"
    askers = {r.requester for r in robot.decision.settled.requests}
    needed = {n for w in situation.wanted for n in services[w].needs}
    shields = {n for n in situation.wanted if any(services[m].protected for m in closure(services, [n]))}
    others = [n for n, rank in situation.ranks.items() if rank < PROTECTED and not services[n].meta
              and n in robot.active() and n not in {*askers, *needed, *shields, *closure(services, [shed])}]
    assert all(situation.ranks[n] >= services[shed].priority for n in others)


def disturb(robot: SimRobot, verb: str, name: str, specs: dict, root: Path, policy: dict) -> None:
    """Something that happens to a robot. What is impossible at the moment does not happen."""
    asked = robot.asked
    if verb in ("request", "lease"):
        request = Request(name, "developer", (name,), ttl=5.0 if verb == "lease" else None, renewed=str(robot.now))
        if not problems(robot.desired.catalog, asked.requests, request):
            robot.asked = asked.put(request)
    elif verb == "release":
        robot.asked = asked.without({("developer", name)})
    elif verb == "hang":
        robot.faults.hang["start", name] = 10.0
    elif verb == "replace":
        specs[name]["container"] = {"environment": {"N": str(robot.now)}}
        robot.declare(load_or_raise(write_tree(root, specs, policies={"policy": policy})))
    elif verb == "hold":
        robot.asked = replace(asked, holds={name: Hold(robot.wall + 4.0)})
    elif verb == "suspend":
        robot.asked = replace(asked, suspended=Hold(robot.wall + 4.0))
    elif verb in ("load", "unload"):
        robot.extra = (1.0, 2 << 30) if verb == "load" else (0.0, 0)
    else:
        current = next((c for c in robot.engine.list() if c.service == name and c.alive), None)
        if current:
            meddle(robot, verb, current)


def meddle(robot: SimRobot, verb: str, current: Container) -> None:
    """Something that happens to a container that is alive."""
    if verb == "request_as":
        other = NAMES[(NAMES.index(current.service) + 3) % len(NAMES)]
        robot.asked = robot.asked.put(Request("r", current.service, (other,), incarnation=current.incarnation))
    elif verb == "kill":
        robot.engine.kill(current.id)
    elif verb == "freeze":
        robot.hung.add(current.incarnation)
    elif verb == "pause":
        with contextlib.suppress(RorgError):
            robot.engine.pause(current.id)
