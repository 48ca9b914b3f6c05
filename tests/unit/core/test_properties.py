"""Invariants over random robots, requests, crashes, drift, people and load, in virtual time.

Every pass, action and call is checked by the invariants of bounded/invariants.py, and so is the state in which the
robot comes to rest.
"""

from __future__ import annotations

import contextlib
import copy
import json
import os
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest
from bounded.invariants import check, same_as_anew
from bounded.watch import Reader, Watch
from common import CASES
from hypothesis import HealthCheck, Phase, given, reject, settings
from hypothesis import strategies as st
from robots import VirtualRobot, handed_on, write_tree

from rorg.core.holds import begin_hold
from rorg.core.objects import found_object
from rorg.core.observed import Container
from rorg.core.requests import problems
from rorg.daemon.snapshot import Snapshots, snapshot
from rorg.errors import Invalid, RorgError
from rorg.manifest.load import load_or_raise
from rorg.model.catalog import Catalog, Request
from rorg.model.units import stamp
from rorg.tools.sim.robot import SimRobot

ROBOTS = CASES / "robots"
"""Found by the properties, and made as small as they go."""
NAMES = [f"s{n}" for n in range(6)]
DEVICE = "/dev/arm"
EXAMPLES = int(os.environ.get("RORG_TEST_EXAMPLES") or 0)
"""Of each property; without it as many as take half a minute together."""
WHOLE = settings(
    max_examples=EXAMPLES or 24,
    deadline=None,
    phases=(Phase.explicit, Phase.reuse, Phase.generate),
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.filter_too_much],
)
HALF = settings(WHOLE, max_examples=EXAMPLES or 12)
REST = 200.0
"""Seconds after the last disturbance; longer than every linger, lease, hold and time of calm together."""
PATIENCE = 10.0
"""Seconds between passes, after the last disturbance, while probes say what they said before."""


COUNTED = Counter[str]()
"""Steps that were taken, and passes of the loop."""


@pytest.fixture(scope="module", autouse=True)
def counts():
    """Tells them at the end, with `-s`."""
    began = time.monotonic()
    yield
    print(f"\n{COUNTED['steps']} steps, {COUNTED['passes']} passes, {time.monotonic() - began:.0f} s")


HARDER = {"deactivate": ["pause", "stop", "remove"], "pause": ["stop", "remove"], "stop": ["remove"]}
"""What may follow after an idle action."""
USERS = [*([{}] * 3), {"gpu": 1}, {"cam": 1}, {"cam": 1, "gpu": 1}, {"bus": 1}, {"bus": 1}, {"bus": 2}]
"""Exclusive resources that a service may use. There are two units of the bus."""
PARAMETERS = [None, None, {"parameters": {"/speed": 0.5}}]


def managed(name: str) -> dict:
    """What makes a service one of ROS 2 with a managed node."""
    return {"profile": "ros2", "command": "nav", "ros": {"lifecycle": [f"/{name}"]}}


@st.composite
def services(draw):
    """Trees without cycles, and without services that could never run: one needs only earlier ones, and nothing that
    excludes it."""
    found: dict[str, dict] = {}
    for index, name in enumerate(NAMES):
        earlier = draw(st.lists(st.sampled_from(NAMES[:index]), max_size=2, unique=True)) if index else []
        exclusive = draw(st.sampled_from(USERS))
        needs: list[str] = []
        for need in earlier:
            used = sum((Counter(found[n]["exclusive"]) for n in below(found, [*needs, need])), Counter(exclusive))
            needs += [need] if used <= Counter(gpu=1, cam=1, bus=2) else []
        others = [n for n in NAMES[:index] if n not in below(found, needs)]
        idle = {
            "action": draw(st.sampled_from(["pause", "deactivate", "stop", "remove"])),
            "linger": draw(st.sampled_from(["0s", "1s", "5s"])),
            "min_active": draw(st.sampled_from(["0s", "2s"])),
        }
        if idle["action"] != "remove" and draw(st.integers(0, 2)) == 0:
            idle["escalate"] = {
                "after": "3s",
                "action": draw(st.sampled_from(HARDER[idle["action"]])),
            }
        how = draw(st.sampled_from([None, None, "network_mode", "pid", "volumes_from"])) if needs else None
        found[name] = {
            "container": joined(how, draw(st.sampled_from(needs))) if how else {},
            "needs": [{"service": n, "restart": True} if draw(st.booleans()) else n for n in needs],
            "always_on": draw(st.integers(0, 5)) == 0,
            "idle": idle,
            "ready": draw(st.sampled_from([{"delay": "300ms"}, {"tcp": 1234}])),
            "live": draw(st.sampled_from([None, {"tcp": 1234}])),
            "interlock": draw(st.sampled_from([None, None, None, {"file": "/allow"}])),
            "driver": draw(
                st.sampled_from([None, None, None, {"devices": [DEVICE]}, {"devices": [DEVICE], "unplugged": "keep"}])
            ),
            **(managed(name) if idle["action"] == "deactivate" else {"ros": draw(st.sampled_from(PARAMETERS))}),
            "priority": draw(st.sampled_from([20, 50, 80])),
            "protected": draw(st.integers(0, 4)) == 0,
            "exclusive": exclusive,
            "conflicts": draw(st.sampled_from([[], [], [], others[:1]])),
            "update": {
                "when": draw(st.sampled_from(["now", "now", "now", "when_ceased"])),
                "bake": draw(st.sampled_from(["0s", "2s", "5s"])),
                "atomic": draw(st.sampled_from([False, False, True])),
            },
            "resources": {"cpu": draw(st.sampled_from([0.1, 0.5])), "memory": draw(st.sampled_from(["1Mi", "1Gi"]))},
        }
        found[name] = {k: v for k, v in found[name].items() if v is not None}
    return found


def joined(option: str, name: str) -> dict:
    """A container that has something of another one."""
    return {option: [name] if option == "volumes_from" else f"service:{name}"}


def below(specs: dict, names: list[str]) -> set[str]:
    """The named services and all that they need."""
    more = [n if isinstance(n, str) else n["service"] for name in names for n in specs[name]["needs"]]
    return {*names, *below(specs, more)} if more else {*names}


POLICIES = st.sampled_from(
    [
        {},
        {"budget": {"cpu": 1.2, "over": "queue"}},
        {"budget": {"cpu": 2.0, "memory": "4Gi"}, "pressure": {"step": "2s", "calm": "4s", "admit": 30}},
        {"budget": {"cpu": 1.5, "over": "queue"}, "pressure": {"step": "1s", "calm": "2s"}, "resources": {"gpu": 2}},
    ]
)
VERBS = (
    "request",
    "request",
    "lease",
    "urgent",
    "release",
    "kill",
    "pause",
    "rest",
    "hang",
    "slow",
    "freeze",
    "thaw",
    "request_as",
    "replace",
    "always_on",
    "needs",
    "hold",
    "suspend",
    "load",
    "unload",
    "lock",
    "unlock",
    "restart",
    "restart_later",
    "outage",
    "refuse",
    "removing",
    "refused",
    "dies",
    "revert",
    "retry",
    "reborn",
    "unplug",
    "plug",
    "plug_elsewhere",
    "clock_back",
    "clock_ahead",
)
EVENTS = st.lists(
    st.tuples(st.sampled_from(VERBS), st.sampled_from(NAMES), st.floats(0, 3, allow_nan=False)), max_size=16
)


@pytest.mark.slow
@WHOLE
@given(services(), POLICIES, EVENTS)
def test_every_robot_comes_to_rest_as_asked(specs, policy, events):
    live_through(specs, policy, events)


CHANGES = st.lists(
    st.tuples(
        st.sampled_from(
            [
                "request",
                "request",
                "release",
                "replace",
                "refused",
                "refused",
                "dies",
                "dies",
                "revert",
                "reborn",
                "kill",
                "restart",
                "retry",
                "lock",
                "clock_back",
                "clock_ahead",
            ]
        ),
        st.sampled_from(NAMES[:2]),
        st.sampled_from([0.0, 0.02, 0.1, 0.2, 0.6, 3.0]),
    ),
    min_size=5,
    max_size=16,
)


@pytest.mark.slow
@HALF
@given(services(), CHANGES)
def test_a_bad_change_never_ends_what_ran(specs, events):
    live_through({n: specs[n] for n in NAMES[:2]}, {}, events)


USES = st.lists(
    st.sampled_from(
        [{}, {"networks": ["n0"]}, {"networks": ["n0", "n1"], "volumes": ["v0:/v"]}, {"volumes": ["v0:/v"]}]
    ),
    min_size=3,
    max_size=3,
)
TURNS = st.lists(
    st.tuples(
        st.sampled_from(
            [
                *("request", "request", "release", "replace", "refused", "kill", "restart", "reborn", "outage"),
                *("network", "network", "volume", "undeclare", "declare", "theirs", "unnet", "no_network"),
            ]
        ),
        st.sampled_from(NAMES[:3]),
        st.sampled_from([0.0, 0.02, 0.1, 0.6, 3.0]),
    ),
    min_size=5,
    max_size=16,
)


@pytest.mark.slow
@HALF
@given(services(), USES, TURNS)
def test_networks_come_and_go_with_who_uses_them(specs, uses, events):
    live_through({n: specs[n] for n in NAMES[:3]}, {}, events, dict(zip(NAMES[:3], uses, strict=True)))


@pytest.mark.slow
@HALF
@given(services(), st.sampled_from(["network_mode", "pid", "volumes_from"]), CHANGES)
def test_what_is_joined_follows_what_it_joins(specs, option, events):
    first, second = ({**specs[n], "exclusive": {}, "conflicts": []} for n in NAMES[:2])
    second |= {"container": joined(option, NAMES[0]), "always_on": True}
    live_through({NAMES[0]: first, NAMES[1]: second}, {}, events)


@pytest.mark.slow
@pytest.mark.parametrize("case", sorted(ROBOTS.glob("*.json")), ids=lambda path: path.stem)
def test_a_robot_that_failed_once_does_not_again(case):
    found = json.loads(case.read_text())
    globals()[found.pop("property")].hypothesis.inner_test(**found)


def test_what_is_not_declared_any_more_is_planned_as_anew(tmp_path):
    specs = {
        "lidar": {"always_on": True, "exclusive": ["can"], "interlock": {"file": "/allow"}},
        "mapper": {"always_on": True},
        "camera": {"always_on": True},
    }
    robot = Reader(load_or_raise(write_tree(tmp_path, specs)))
    robot.settle()
    robot.locked.add("lidar")
    robot.faults.fail["remove", "camera"] = ["device or resource busy"] * 3
    robot.at(20.0, robot.locked.clear)
    specs = {"mapper": {"always_on": True}, "arm": {"always_on": True, "exclusive": ["can"]}}
    robot.declare(load_or_raise(write_tree(tmp_path, specs)))
    robot.run(lambda r: same_as_anew(r.read, r.decision) or (r.idle and r.active() == {"mapper", "arm"}))


def test_what_waits_for_a_resource_is_planned_as_anew(tmp_path):
    specs = {
        "camera": {"exclusive": ["gpu"], "idle": {"action": "stop"}},
        "vision": {"exclusive": ["gpu"], "priority": 90},
        "speech": {"conflicts": ["vision"]},
    }
    robot = Reader(load_or_raise(write_tree(tmp_path, specs)))
    for service in ("camera", "vision", "speech"):
        asked = Request("test", "developer", (service,))
        robot.document = robot.document.put(asked)
        robot.run(lambda r, name=service: same_as_anew(r.read, r.decision) or (r.idle and r.active() == {name}))


def test_what_a_cold_start_costs_grows_with_its_size(tmp_path):
    assert planned(tmp_path / "large", 80) <= 2.3 * planned(tmp_path / "small", 40)


def planned(folder: Path, count: int) -> int:
    """How often a service is planned until so many, in chains of five that need one another, run from nothing, and have
    stayed well."""
    names = [f"s{n:03}" for n in range(count)]
    specs = {n: {"needs": names[i - 1 : i] if i % 5 else [], "always_on": i % 5 == 4} for i, n in enumerate(names)}
    robot, costs = SimRobot(load_or_raise(write_tree(folder, specs))), []

    def up(robot: SimRobot) -> bool:
        costs.append(len(robot.decision.planned.replanned))
        baked = all(p.update.baked for p in robot.memory.progress.values())
        return len(robot.active()) == count and baked and robot.decision.plan.empty

    robot.run(up, 10 * count)
    return sum(costs)


@pytest.mark.slow
def test_services_that_wait_for_their_next_try_cost_little(tmp_path):
    """They are planned when their try is due."""
    count, costs = 40, []
    robot = SimRobot(load_or_raise(write_tree(tmp_path, {f"s{n:02}": {"always_on": True} for n in range(count)})))
    robot.faults.crash_after = {f"s{n:02}": 1 + n / 100 for n in range(count)}  # seldom two at once
    robot.run(lambda r: r.now > 120, 200)
    robot.run(lambda r: costs.append(len(r.decision.planned.replanned)) or r.now > 240, 200)
    assert len(costs) > 3 * count
    assert sum(costs) < 2 * len(costs)


def live_through(specs, policy, events, uses=None):
    with tempfile.TemporaryDirectory() as folder:
        world = World(Path(folder), specs, policy, uses or {})
        try:
            robot = Reader(world.load())
        except Invalid:
            reject()  # by chance all of it could never be active together
        end = 0.0
        for verb, name, pause in events:
            end += pause
            robot.at(end, lambda verb=verb, name=name: disturb(robot, verb, name, world))
        robot.at(end, lambda: robot.locked.clear())
        robot.at(end, lambda: [robot.engine.objects.pop(k) for k, o in [*robot.engine.objects.items()] if not o.owner])
        robot.at(end, lambda: setattr(robot, "patience", PATIENCE))
        robot.at(end + REST, lambda: None)
        watch = Watch(robot, check)
        robot.run(lambda r: watch.passed() and r.now >= end + REST, end + 2 * REST)
        check("rest", watch)
        COUNTED["passes"] += watch.passes


class World:
    """What the manifests say, as it changes."""

    def __init__(self, root: Path, specs: dict, policy: dict, uses: dict) -> None:
        self.root, self.specs, self.policy, self.uses = root, copy.deepcopy(specs), policy, uses
        self.networks: dict[str, dict] = {"n0": {}, "n1": {"internal": True}} if uses else {}
        self.volumes: dict[str, dict] = {"v0": {}} if uses else {}

    def load(self) -> Catalog:
        declared = {"networks": self.networks, "volumes": self.volumes}
        specs = {n: {**s, "container": {**s.get("container", {}), **self._used(n)}} for n, s in self.specs.items()}
        policy = {**self.policy, "resources": {"bus": 2, **self.policy.get("resources", {})}}
        return load_or_raise(write_tree(self.root, specs, policies={"policy": policy}, **declared))

    def _used(self, name: str) -> dict:
        """What a service uses of what is declared."""
        found = dict(self.uses.get(name, {}))
        found["networks"] = [n for n in found.get("networks", ()) if n in self.networks]
        return {k: v for k, v in found.items() if v}

    def change(self, robot: SimRobot, name: str, **changes) -> None:
        """Changes a manifest, unless that would be refused."""
        before = self.specs[name]
        self.specs[name] = {**before, **changes}
        try:
            robot.declare(self.load())
        except Invalid:
            self.specs[name] = before


def disturb(robot: SimRobot, verb: str, name: str, world: World) -> None:
    """Something that happens to a robot. What is impossible at the moment does not happen."""
    COUNTED["steps"] += 1
    if verb in ("replace", "always_on", "needs", "refused", "dies", "revert"):
        rewrite(robot, verb, name, world)
    elif verb in ("network", "volume", "undeclare", "declare", "theirs", "unnet", "no_network"):
        connect(robot, verb, "n" + name[1:] if name != "s2" else "n1", world)
    elif verb == "reborn":
        robot.reborn(handed_on(robot.decision))
    elif verb in ("clock_back", "clock_ahead"):
        robot.clock_set += 3600.0 if verb == "clock_ahead" else -3600.0
    elif verb in ("unplug", "plug", "plug_elsewhere"):
        replug(robot, verb)
    elif verb in ("hang", "slow", "refuse", "outage", "load", "unload", "lock", "unlock"):
        spoil(robot, verb, name, world)
    elif verb in ("kill", "pause", "rest", "freeze", "thaw", "request_as", "removing"):
        current = next((c for c in robot.engine.list() if c.service == name and (c.alive or verb == "removing")), None)
        if current:
            meddle(robot, verb, current)
    else:
        ask(robot, verb, name)


def ask(robot: SimRobot, verb: str, name: str) -> None:
    """A person writes into the requests file."""
    asked = robot.document
    if verb in ("request", "lease", "urgent"):
        request = Request(
            name,
            "developer",
            (name,),
            ttl=5.0 if verb == "lease" else None,
            renewed=str(robot.now),
            priority=90 if verb == "urgent" else None,
        )
        if not problems(robot.desired.catalog, asked.requests, request):
            robot.document = asked.put(request)
    elif verb == "release":
        robot.document = asked.without({("developer", name)})
    elif verb == "hold":
        robot.document = replace(asked, holds={name: begin_hold(robot.moment, 4.0)})
    elif verb == "suspend":
        robot.document = replace(asked, suspended=begin_hold(robot.moment, 4.0))
    elif verb == "retry":
        robot.document = replace(asked, retries={**asked.retries, name: stamp(robot.wall)})
    else:
        at = stamp(robot.wall + {"restart": 0.0, "restart_later": 5.0}[verb])
        robot.document = replace(asked, restarts={**asked.restarts, name: at})


def rewrite(robot: SimRobot, verb: str, name: str, world: World) -> None:
    """A person writes a manifest."""
    spec = world.specs[name]
    keep = {k: v for k, v in spec["container"].items() if k != "environment"}
    if verb == "replace":
        world.change(robot, name, container={**keep, "environment": {"N": str(robot.now)}})
    elif verb == "always_on":
        world.change(robot, name, always_on=not spec["always_on"])
    elif verb in ("refused", "dies"):
        world.change(robot, name, container={**keep, "environment": {"N": str(robot.now), "BAD": "1"}})
        robot.faults.bad[robot.desired.digests[name]] = {"refused": "start", "dies": "exit"}[verb]
    elif verb == "revert":
        world.change(robot, name, container=keep)
    else:
        first = [{"service": n, "restart": True} for n in NAMES[: NAMES.index(name)][:1]]
        world.change(robot, name, needs=[] if spec["needs"] else first)


def connect(robot: SimRobot, verb: str, name: str, world: World) -> None:
    """Networks and volumes change, in manifests or behind rorg's back."""
    objects, key = robot.engine.objects, f"network/{name}"
    if verb == "network" and name in world.networks:
        world.networks[name] = {"internal": not world.networks[name].get("internal", False)}
    elif verb == "volume":
        world.volumes["v0"] = {"driver_opts": {"o": str(robot.now)}}
    elif verb == "undeclare":
        world.networks.pop(name, None)
    elif verb == "declare":
        world.networks.setdefault(name, {})
    elif verb == "theirs" and key not in objects:
        objects[key] = found_object("network", name, f"theirs{robot.now}", {})
    elif verb == "unnet" and not any(c.alive and name in c.networks for c in robot.engine.list()):
        objects.pop(key, None)
    elif verb == "no_network":
        robot.faults.fail["create", key] = ["the subnet is taken"] * 2
    robot.declare(world.load())


def spoil(robot: SimRobot, verb: str, name: str, world: World) -> None:
    """Something around it goes wrong, or well again."""
    if verb in ("hang", "slow"):
        robot.faults.hang["start" if verb == "hang" else "stop", name] = 10.0
    elif verb == "refuse":
        robot.faults.fail["update", name] = ["no such cgroup"] * 3
    elif verb == "outage":
        robot.faults.unreachable = True
        robot.at(robot.now + 3.0, lambda: setattr(robot.faults, "unreachable", False))
    elif verb in ("load", "unload"):
        robot.extra = (1.0, 2 << 30) if verb == "load" else (0.0, 0)
    else:
        robot.locked = {name} if verb == "lock" and "interlock" in world.specs[name] else set()


def replug(robot: SimRobot, verb: str) -> None:
    """A person pulls the plug of the device of drivers, or puts it in."""
    if verb == "unplug":
        robot.engine.unplug(DEVICE)
        robot.at(robot.now + 4.0, lambda: robot.engine.plug(DEVICE))
    else:
        robot.engine.plug(DEVICE, number={"plug": "c 188:0", "plug_elsewhere": "c 188:1"}[verb])


def meddle(robot: SimRobot, verb: str, current: Container) -> None:
    """Something that happens to a container."""
    if verb == "request_as":
        other = NAMES[(NAMES.index(current.service) + 3) % len(NAMES)]
        request = Request("r", current.service, (other,), incarnation=current.incarnation)
        if not problems(robot.desired.catalog, robot.document.requests, request):
            robot.document = robot.document.put(request)
    elif verb == "kill":
        robot.engine.kill(current.id)
    elif verb == "freeze":
        robot.hung.add(current.incarnation)
    elif verb == "thaw":
        robot.hung.discard(current.incarnation)
    elif verb == "removing":
        robot.engine.containers[current.id] = replace(current, state="removing")
        robot.at(robot.now + 2.0, lambda: robot.engine.containers.pop(current.id, None))
    elif verb == "pause":
        with contextlib.suppress(RorgError):
            robot.engine.pause(current.id)
    elif verb == "rest" and robot.desired.catalog.services[current.service].managed:  # somebody deactivates its node
        with contextlib.suppress(RorgError):
            robot.engine.deactivate(current.id, 0, ())


def test_a_hold_that_is_made_longer_is_told_so(tmp_path):
    robot = VirtualRobot(tmp_path)
    robot.declare({"arm": {}, "hand": {"always_on": True}})
    robot.settle()
    texts, before = Snapshots(), {}
    for seconds in (500, 5000):
        robot.hold("arm", seconds)
        robot.wait(lambda was=before: robot.sim.decision.holds != was, 10)
        before = robot.sim.decision.holds
        texts.note(robot.sim.decision)
        assert json.loads(texts.text({})) == json.loads(json.dumps(snapshot(robot.sim.decision, {})))
        for _ in range(3):  # until nothing of it is looked at any more
            robot.wait(lambda then=robot.sim.decision: robot.sim.decision is not then, 60)
            texts.note(robot.sim.decision)
            texts.text({})


def test_that_a_trial_went_well_is_told_while_another_change_waits(tmp_path):
    robot = VirtualRobot(tmp_path)
    update = {"when": "when_ceased", "bake": "20s"}
    arm = {"always_on": True, "ready": {"delay": "300ms"}, "live": {"tcp": 1234}, "update": update}
    robot.declare({"arm": arm})
    robot.settle()
    robot.declare({"arm": {**arm, "container": {"environment": {"N": "1"}}}})
    robot.change(lambda asked: replace(asked, restarts={"arm": stamp(robot.wall())}))
    robot.wait(lambda: any(c.previous and c.active for c in robot.sim.engine.list()))
    robot.declare({"arm": {**arm, "container": {"environment": {"N": "2"}}}})
    texts, reasons = Snapshots(), []

    def told(robot: SimRobot) -> bool:
        texts.note(robot.decision)
        conditions = json.loads(texts.text({}))["services"]["arm"]["conditions"]
        assert conditions == json.loads(json.dumps(snapshot(robot.decision, {})))["services"]["arm"]["conditions"]
        reasons.extend(c["reason"] for c in conditions if c["type"] == "Updated")
        return "Baking" in reasons

    robot.sim.run(told, 20)
    assert "OnTrial" in reasons


def test_a_need_that_is_restarted_during_a_start_restarts_what_starts(tmp_path):
    """The engine dates a run at the end of its start, so its times do not tell which run of the need it counts on."""
    need = {"service": "base", "restart": True}
    robot = SimRobot(load_or_raise(write_tree(tmp_path, {"base": {}, "scan": {"always_on": True, "needs": [need]}})))
    robot.faults.hang["start", "scan"] = 10.0
    robot.at(3.0, lambda: robot.engine.kill(next(c.id for c in robot.engine.list() if c.service == "base")))
    robot.settle()
    assert [verb for _, verb, service in robot.engine.calls if service == "scan"] == [
        "create",
        "start",
        "stop",
        "start",
    ]
