"""What measures against overload would free, and who may be shed (rorg/core/eviction.py)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from situations import NOW, SPEC, box

from rorg.core.admission import admit
from rorg.core.desired import desire
from rorg.core.eviction import Victims, evict
from rorg.core.inputs import Inputs
from rorg.core.memory import InFlight, Memory, Progress
from rorg.core.observed import Container, Observed
from rorg.core.operations import Pause, Start
from rorg.core.plan import Action
from rorg.core.pressure import MEASURES, NONE, PATIENCE, Pressure, Shed
from rorg.core.situation import Measures
from rorg.model.catalog import Catalog, Idle, Request, Service
from rorg.model.load import Load
from rorg.model.policy import Budget, Policy, Thresholds
from rorg.model.probe import Probe

META = Service("developer", meta=True)
USE = (1.0, 100 << 20)
POLICY = Policy(pressure=Thresholds(step=0.0), budget=Budget(cpu=2.0, memory=1 << 30))
ALL = replace(NONE, level=len(MEASURES) - 1)
"""Every measure but shedding is in force."""


def made(name: str, **more: Any) -> Service:
    return Service(name, **{"spec": SPEC, "always_on": True, **more})


def load(**more: Any) -> Load:
    """A machine with 4 cores and 2 GiB, on which 3 cores of 2 are in use."""
    return Load(**{"at": NOW, "cpu": 3.0, "cores": 4.0, "memory": 0, "memory_total": 2 << 30, **more})


class Robot:
    """Services that run as their containers say; without containers, all of them."""

    def __init__(self, *services: Service, seen: tuple[Container, ...] = (), **more: Any) -> None:
        declared = {s.name: s for s in (META, *services)}
        catalog = Catalog(services=declared, policy=more.pop("policy", POLICY))
        requests, shed = more.pop("requests", ()), more.pop("shed", ())
        self.excluded, self.locked = {name: "shed" for name in shed}, more.pop("locked", ())
        self.admission = admit(catalog, requests, self.excluded)
        self.free = admit(catalog, requests, {})
        seen = seen or tuple(box(s.name) for s in services if s.spec is not None)
        use = more.pop("use", {c.service: USE for c in seen if c.state == "running"})
        self.memory = more.pop("memory", Memory())
        self.inputs = Inputs(
            desired=desire(catalog),
            observed=Observed(seen),
            memory=self.memory,
            now=NOW,
            owner="robot",
            requests=requests,
            restarts={},
            results={},
            load=more.pop("load", load(use=use)),
        )

    @property
    def victims(self) -> Victims:
        return Victims(self.inputs, self.admission, self.free, self.excluded, self.locked)

    def names(self) -> set[str]:
        return set(self.victims.names())

    def evict(self, pressure: Pressure, back: dict[str, int] | None = None, suspended: bool = False):
        return evict(replace(self.memory, pressure=pressure), self.victims, back or {}, suspended)

    def measures(self, pressure: Pressure = NONE) -> list[str]:
        """Those that are in force, one after another as they are taken."""
        memory, found, at = self.memory, list[str](), NOW
        memory = replace(memory, pressure=pressure)
        for _ in MEASURES[:-1]:
            at += 1.0
            self.inputs = replace(self.inputs, load=replace(self.inputs.load, at=at))
            memory, _ = evict(memory, self.victims, {}, False)
            found += [m for m in MEASURES[:-1] if memory.pressure.in_force(m) and m not in found]
        return found


CLOSE = "close-admission"


# -- who may be shed -------------------------------------------------------------------------------------------


def test_what_others_need_or_ask_for_is_not_shed():
    arm, map_, tour = made("arm", needs=("base",)), made("map", always_on=False), made("tour")
    robot = Robot(made("base"), arm, map_, tour, requests=(Request("r", "tour", ("map",)),))
    assert robot.names() == {"arm", "map"}


def test_a_request_for_what_does_not_run_protects_nobody():
    robot = Robot(made("map", always_on=False), made("tour"), requests=(Request("r", "tour", ("gone",)),))
    assert robot.names() == {"tour"}


def test_what_a_shed_service_needs_is_not_shed_in_its_place():
    robot = Robot(made("base"), made("arm", needs=("base",)), made("map"), shed=("arm",))
    assert robot.names() == {"map"}


@pytest.mark.parametrize("state", ["running", "paused", "exited", "created", "restarting"])
def test_only_what_runs_or_is_paused_can_be_shed(state):
    robot = Robot(made("arm"), made("map"), seen=(box("arm", state), box("map")))
    assert robot.names() == ({"arm", "map"} if state in ("running", "paused") else {"map"})


def test_what_is_protected_or_locked_or_has_no_container_stays():
    robot = Robot(made("stop", protected=True), made("arm"), made("map"), Service("crew", meta=True), locked=("arm",))
    assert robot.names() == {"map"}
    away = Service("there", away="head", machine="head", always_on=True)
    assert Robot(made("map"), away, seen=(box("map"), box("there"))).names() == {"map"}


def test_shedding_takes_along_what_only_that_service_asked_for():
    tour = made("tour", priority=10)
    lidar = made("lidar", always_on=False, cpu=1.0)
    robot = Robot(tour, lidar, requests=(Request("r", "tour", ("lidar",)),))
    assert robot.victims.victim("tour") == ("tour", 2.0, 200 << 20)
    assert robot.victims.victim("lidar") == ("lidar", 1.0, 100 << 20)
    locked = Robot(tour, lidar, requests=(Request("r", "tour", ("lidar",)),), locked=("lidar",))
    assert locked.victims.victim("tour") == ("tour", 1.0, 100 << 20), "the lidar may not be touched"
    seen = (box("tour"), box("lidar", "paused"))
    assert Robot(tour, lidar, seen=seen, requests=(Request("r", "tour", ("lidar",)),)).victims.victim("tour")[1] == 1.0
    guard = made("guard", always_on=False, protected=True)
    protected = Robot(tour, guard, requests=(Request("r", "tour", ("guard",)),))
    assert protected.victims.victim("tour") is None


def test_use_that_was_not_measured_is_what_is_declared():
    robot = Robot(made("arm", cpu=0.5, memory=7), made("map", cpu=0.5, memory=7), use={"map": USE})
    assert robot.victims.use("arm") == (0.5, 7)
    assert robot.victims.use("map") == USE
    assert Robot(made("arm", cpu=0.5), load=None).victims.use("arm") == (0.5, 0)


def test_the_least_important_that_frees_enough_is_next():
    services = made("arm", priority=20), made("map", priority=10), made("nav", priority=10), made("log", priority=1)
    use = {"arm": USE, "map": USE, "nav": (1.5, 0), "log": (0.001, 0)}
    robot = Robot(*services, use=use)
    assert robot.victims.next_one(("cpu",)) == ("nav", 1.5, 0), "log frees next to nothing; nav uses more than map"
    short_of_memory = load(use=use, cpu=0.0, memory=(1 << 30) + (300 << 20))
    robot = Robot(*services, load=short_of_memory)
    assert robot.victims.next_one(("memory",)) == ("map", *USE)
    assert Robot(services[-1], use=use).victims.next_one(("cpu",)) is None


def test_what_matters_less_is_told_the_least_first():
    services = made("arm", priority=20), made("map", priority=10), made("nav", priority=10), made("log", priority=30)
    robot = Robot(*services, made("back", priority=20), shed=("back",))
    assert [name for name, *_ in robot.victims.below("back")] == ["map", "nav"]
    assert [name for name, *_ in robot.victims.below("nobody")] == []
    zero = Robot(made("arm", priority=0), made("map", priority=0))
    assert zero.victims.below("nobody") == [], "what nothing wants is below everything"


# -- which measures help ---------------------------------------------------------------------------------------


def test_shares_are_lowered_of_running_services_below_the_top():
    top, other = made("arm", priority=90), made("map", priority=10)
    assert Robot(top, other).measures() == ["lower-shares", CLOSE]
    _, measures = Robot(top, other).evict(ALL)
    assert measures.lowered == {"map"}
    assert Robot(top, other, seen=(box("arm"), box("map", "paused"))).measures() == [CLOSE]
    assert "lower-shares" not in Robot(made("arm", priority=10), made("map", priority=10)).measures()
    locked = replace(other, interlock=Probe("tcp", 80))
    assert "lower-shares" not in Robot(top, locked).measures(), "a change of shares is not worth asking the hardware"


def test_above_all_priorities_is_who_is_protected_and_nobody_is_lowered_for_another():
    protected, most = made("stop", protected=True), made("arm", priority=100)
    _, measures = Robot(protected, most).evict(ALL)
    assert measures.lowered == {"arm"}
    both = made("halt", protected=True)
    assert Robot(protected, both).evict(ALL)[1].lowered == frozenset()
    crew = Service("crew", meta=True)
    assert Robot(most, crew).evict(ALL)[1].lowered == frozenset(), "a meta-service has no shares"
    assert Robot(crew).evict(ALL)[1].lowered == frozenset()


def test_lingering_ends_if_that_frees_what_is_short():
    idle = made("map", always_on=False, idle=Idle(action="stop", linger=60.0))
    arm = made("arm", priority=90)
    assert Robot(arm, idle).measures() == ["end-lingering", CLOSE]
    assert Robot(arm, idle, seen=(box("arm"), box("map", "exited"))).measures() == [CLOSE]
    memory = load(cpu=0.0, memory=2 << 30, use={"map": USE, "arm": USE})
    assert Robot(arm, idle, load=memory).measures() == ["end-lingering", CLOSE]
    pausing = replace(idle, idle=Idle(action="pause", linger=60.0))
    assert Robot(arm, pausing, load=memory).measures() == [CLOSE], "to pause it frees no memory"
    assert Robot(arm, pausing).measures() == ["end-lingering", CLOSE]
    assert Robot(arm, seen=(box("arm"), box("gone"))).measures() == [CLOSE], "nobody declares it"


def test_what_was_preempted_does_not_linger():
    gpu = {"gpu": 1}
    winner, loser = made("arm", exclusive=gpu, priority=90), made("map", exclusive=gpu)
    assert Robot(winner, loser).measures() == [CLOSE]


def test_paused_services_are_stopped_if_memory_is_short():
    arm = made("arm", priority=90)
    idle = made("map", always_on=False, idle=Idle(action="pause"))
    seen = box("arm"), box("map", "paused")
    memory = load(cpu=0.0, memory=2 << 30, use={"map": USE, "arm": USE})
    assert Robot(arm, idle, seen=seen, load=memory).measures() == ["stop-paused", CLOSE]
    assert Robot(arm, idle, seen=seen).measures() == [CLOSE], "that frees no CPU"
    assert Robot(arm, replace(idle, always_on=True, priority=90), seen=seen, load=memory).measures() == [CLOSE]
    assert Robot(arm, idle, seen=(box("arm"), box("map", "exited")), load=memory).measures() == [CLOSE]


def test_admission_is_closed_whoever_runs():
    """Requests of services that matter less may be yet to come."""
    arm = made("arm", priority=100)
    assert Robot(arm).measures() == [CLOSE]
    nobody = replace(POLICY, pressure=replace(POLICY.pressure, admit=0))
    assert Robot(arm, policy=nobody).measures() == [], "it would keep nobody out"
    assert Robot(arm, policy=replace(nobody, pressure=replace(POLICY.pressure, admit=1))).measures() == [CLOSE]


# -- the state -------------------------------------------------------------------------------------------------


def test_without_thresholds_nothing_is_in_force():
    robot = Robot(made("arm"), policy=Policy())
    memory, measures = robot.evict(ALL)
    assert (memory.pressure, measures) == (NONE, Measures())
    calm = replace(robot.memory, pressure=replace(NONE, seen=5.0))
    assert evict(calm, robot.victims, {}, False) == (calm, Measures())


def test_while_nothing_can_be_done_nothing_is_concluded():
    robot = Robot(made("arm", priority=90), made("map", priority=10))
    memory, measures = robot.evict(NONE, suspended=True)
    assert (memory.pressure, measures) == (NONE, Measures())
    memory, measures = robot.evict(ALL, suspended=True)
    assert memory.pressure is ALL
    assert (measures.hurry, measures.lowered) == (True, {"map"})
    unchanged = replace(robot.memory, pressure=replace(NONE, seen=NOW))
    assert evict(unchanged, robot.victims, {}, False)[0] is unchanged, "the sample was seen before"


@pytest.mark.parametrize(("back", "stays"), [(-1, False), (0, True), (100, True), (101, False), (None, False)])
def test_a_shed_service_stays_shed_while_something_wants_it_that_is_not_protected(back, stays):
    one = Shed("map", 1.0, 0, "too much")
    robot = Robot(made("arm"), made("map"), shed=("map",), seen=(box("arm"), box("map", "exited")))
    pressure = replace(ALL, level=len(MEASURES), shed=(one,), seen=NOW)
    memory, measures = robot.evict(pressure, {} if back is None else {"map": back})
    assert memory.pressure.shed == ((one,) if stays else ())
    assert measures.shed == ({"map"} if stays else set())


def sheds(memory: Memory = Memory(), **more: Any) -> bool:
    """Whether the next sample sheds one of two services."""
    robot = Robot(made("arm", priority=90), made("map", priority=10), memory=memory, **more)
    pressure = replace(ALL, pressed=("cpu",), changed_at=0.0)
    return bool(robot.evict(pressure)[0].pressure.shed)


def test_nobody_is_shed_while_something_begins_whose_use_is_not_known():
    assert sheds()
    begins = InFlight(Action(0, Start(container="map"), "map"), NOW - 1)
    assert not sheds(Memory(in_flight={"map": begins}))
    assert sheds(Memory(in_flight={"map": replace(begins, since=NOW - PATIENCE)})), "it hangs"
    assert not sheds(Memory(in_flight={"map": replace(begins, since=NOW - PATIENCE + 0.1)}))
    assert sheds(Memory(in_flight={"map": InFlight(Action(0, Pause(container="map"), "map"), NOW - 1)}))
    new = Memory({"map": Progress(running_since=NOW - 1)})
    assert not sheds(new, use={"arm": USE})
    assert sheds(new), "its use is measured"
    assert sheds(Memory({"map": Progress(running_since=NOW - PATIENCE)}), use={"arm": USE})
    assert sheds(Memory({"map": Progress()}), use={"arm": USE})
    assert sheds(new, use={"arm": USE}, seen=(box("arm"), box("map", "paused"))), "it does not begin"


def test_the_next_is_shed_when_the_last_one_has_ended():
    one = Shed("map", 1.0, 0, "too much")
    for state, settling in (("running", True), ("restarting", True), ("paused", True), ("exited", False)):
        services = made("arm", priority=90), made("nav", priority=20), made("map", priority=10)
        seen = box("arm"), box("nav"), box("map", state)
        robot = Robot(*services, shed=("map",), seen=seen, use={"arm": USE, "nav": USE, "map": USE})
        pressure = replace(ALL, level=len(MEASURES), shed=(one,), changed_at=NOW - 1, pressed=("cpu",))
        memory, _ = robot.evict(pressure, {"map": 10})
        assert (len(memory.pressure.shed) == 1) is settling, state


def test_why_admission_is_closed_is_told():
    _, measures = Robot(made("arm", priority=10)).evict(replace(ALL, reason="3.0 of 2.0 cores in use", seen=NOW))
    assert measures.closed == "the machine is under pressure: 3.0 of 2.0 cores in use"
    assert (measures.hurry, measures.stop_paused) == (True, True)
    _, measures = Robot(made("arm")).evict(replace(NONE, level=1, seen=NOW))
    assert (measures.closed, measures.hurry, measures.stop_paused) == ("", False, False)
