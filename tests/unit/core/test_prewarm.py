"""When a service is started before it is requested (rorg/core/prewarm.py): each case on its own, at exact times.

In all of them the developer has requested `ears` since second 10, and after a minute of that always requests `wheels`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from rorg.core.admission import admit
from rorg.core.desired import desire
from rorg.core.inputs import Inputs
from rorg.core.memory import Attempt, InFlight, Memory, Progress
from rorg.core.observed import Container, Observed
from rorg.core.operations import Start
from rorg.core.plan import Action
from rorg.core.prewarm import FAILED, HOLD, Prewarmed, harmless, prewarm
from rorg.core.update import Update
from rorg.model.catalog import DEVELOPER, Catalog, Idle, Request, Service
from rorg.model.learned import Departure, Learned
from rorg.model.policy import Budget, Policy
from rorg.model.probe import Probe

ASKED, DUE = 10.0, 67.0
"""When `ears` was requested; a start takes 2 s, and rorg predicts every second, so `wheels` is due 3 s before 70."""
EARS = Request("look", DEVELOPER, ("ears",))
WHEELS = Service("wheels", spec={"image": "x"}, idle=Idle(prewarm=0.2))
LEARNED = Learned({DEVELOPER: {("ears",): (Departure(60.0, ("wheels",)),) * 10}})
SERVICES = {
    DEVELOPER: Service(DEVELOPER, meta=True),
    "ears": Service("ears", spec={"image": "x"}),
    "map": Service("map", spec={"image": "x"}),
    "dock": Service("dock", spec={"image": "x"}),
    "wheels": WHEELS,
}
DIGEST = desire(Catalog(services=SERVICES)).digests["wheels"]


def box(service: str = "wheels", state: str = "exited", **more: Any) -> Container:
    return Container(**{"id": service, "name": service, "service": service, "state": state, "digest": DIGEST, **more})


class Robot:
    """Passes of prewarming alone, one after another."""

    def __init__(self, learned: Learned | None = LEARNED, policy: Policy = Policy(), **services: Service) -> None:
        self.desired = desire(Catalog(services={**SERVICES, **services}, policy=policy))
        self.learned, self.memory = learned, Memory()
        self.boxes: tuple[Container, ...] = tuple(box(name) for name in ("ears", "map", "dock", "wheels"))
        self.requests: tuple[Request, ...] = ()
        self.at(0.0)
        self.requests = (EARS,)
        self.at(ASKED)

    def at(self, now: float, barred: tuple[str, ...] = (), off: bool = False) -> Prewarmed:
        inputs = Inputs(
            desired=self.desired,
            observed=Observed(self.boxes),
            memory=self.memory,
            now=now,
            owner="robot",
            requests=self.requests,
            restarts={},
            results={},
            learned=self.learned,
        )
        admission = admit(self.desired.catalog, self.requests, {})
        memory, found = prewarm(self.memory, inputs, admission, self.requests, barred, off)
        assert (found.wanted is admission.wanted) is not found.names
        self.memory = replace(memory, asked=self.requests)
        return found

    def knows(self, **changes: Any) -> Robot:
        """It remembers this of `wheels`."""
        progress = {**self.memory.progress, "wheels": replace(Progress(), **changes)}
        self.memory = replace(self.memory, progress=progress)
        return self

    def sees(self, *boxes: Container) -> Robot:
        self.boxes = boxes
        return self


def test_it_begins_as_early_as_it_must_to_be_ready_in_time():
    robot = Robot()
    assert robot.at(66.9) == Prewarmed(admit(robot.desired.catalog, (EARS,), {}).wanted, look=67.9)
    due = robot.at(DUE)
    assert (due.names, due.look) == ({"wheels"}, 70.0)
    (cause,) = due.wanted["wheels"]
    assert (cause.kind, cause.by) == ("prewarmed", DEVELOPER)
    assert str(cause.likely) == "developer asks for it within 3.0 s in 91% of cases"


@pytest.mark.parametrize(
    ("known", "seen", "took", "due"),
    [
        ({}, box(), {}, 67.0),
        ({}, box(state="paused"), {}, 68.8),
        ({}, box(), {"start": 5.0, "resume": 3.0}, 64.0),
        ({}, box(state="paused"), {"start": 5.0, "resume": 3.0}, 66.0),
        ({"ready": True}, box(), {}, 69.0),
    ],
)
def test_how_long_it_will_take_is_known_from_earlier(known, seen, took, due):
    robot = Robot(replace(LEARNED, took={"wheels": took})).knows(**known).sees(seen)
    assert not robot.at(due - 0.01).names
    assert robot.at(due).names == {"wheels"}


def test_the_slowest_need_counts_too():
    robot = Robot(replace(LEARNED, took={"map": {"start": 5.0}}), wheels=replace(WHEELS, needs=("dock", "map", "gone")))
    assert not robot.at(61.9).names
    due = robot.at(62.0)
    assert due.names == {"wheels", "map", "dock"}
    assert [str(cause) for cause in due.wanted["map"]] == ["needed by wheels"]
    assert "prewarmed" in str(due.wanted["wheels"][0])


@pytest.mark.parametrize(
    "change",
    [
        lambda robot: robot.knows(exits=1),
        lambda robot: robot.knows(update=Update(edition="now", quarantined={"now": "late"})),
        lambda robot: robot.knows(attempts={"create": Attempt(error="no image")}),
        lambda robot: robot.knows(attempts={"start": Attempt(at=DUE + 1)}),
        lambda robot: robot.sees(),
        lambda robot: robot.sees(box(), box(id="other")),
        lambda robot: robot.sees(box(digest="v1:0")),
        lambda robot: robot.sees(box(state="dead")),
    ],
    ids=["crashed", "quarantined", "failed", "backs off", "no container", "two", "changed", "dead"],
)
def test_a_service_with_any_trouble_stays_idle(change):
    assert Robot().at(DUE).names == {"wheels"}
    assert not change(Robot()).at(DUE).names


@pytest.mark.parametrize("state", ["created", "exited", "inactive", "paused", "running"])
def test_every_state_from_which_it_can_go_on_will_do(state):
    assert Robot().sees(box(state=state)).at(69.0).names == {"wheels"}


def test_an_earlier_attempt_without_an_error_is_no_trouble():
    assert Robot().knows(attempts={"start": Attempt(at=DUE)}).at(DUE).names == {"wheels"}


@pytest.mark.parametrize(
    ("change", "is_harmless"),
    [
        ({}, True),
        ({"ready": Probe("tcp", 80)}, True),
        ({"interlock": Probe("tcp", 80)}, False),
        ({"exclusive": {"gpu": 1}}, False),
        ({"may_request": ("map",)}, False),
        ({"ready": Probe("completed", "")}, False),
        ({"meta": True}, False),
        ({"spec": None}, False),
    ],
)
def test_only_what_needs_no_permission_and_takes_nothing_is_started(change, is_harmless):
    assert harmless(replace(WHEELS, **change)) is is_harmless
    assert bool(Robot(wheels=replace(WHEELS, **change)).at(69.5).names) is is_harmless or change.get("meta")


def test_it_takes_the_place_of_nothing():
    rival = {"wheels": replace(WHEELS, conflicts=("dock",))}
    assert Robot(**rival).at(DUE).names == {"wheels"}
    assert not Robot(**rival).sees(box(), box("dock", "running")).at(DUE).names, "it is active"
    asks_for_dock = Learned({**LEARNED.departures, "bridge": {("dock",): ()}})
    assert not Robot(asks_for_dock, **rival).at(DUE).names, "someone may request it"
    held = Robot()
    assert not held.at(DUE, barred=("wheels",)).names
    both = {"wheels": replace(WHEELS, exclusive={}, conflicts=("ears",))}
    assert not Robot(**both).at(DUE).names, "it is wanted"


def test_it_needs_room_in_the_budget():
    small = {"ears": replace(SERVICES["ears"], cpu=1.0), "wheels": replace(WHEELS, cpu=1.0)}
    for cpu, names in ((2.0, {"wheels"}), (1.9, set())):
        assert Robot(policy=Policy(budget=Budget(cpu=cpu)), **small).at(DUE).names == names


def test_it_must_be_probable_enough():
    """Ten of eleven, because one more departure is counted that leads elsewhere."""
    for enough, names in ((0.9, {"wheels"}), (0.92, set()), (0.0, set())):
        assert Robot(wheels=replace(WHEELS, idle=Idle(prewarm=enough))).at(DUE).names == names


def test_nothing_is_prewarmed_when_it_is_turned_off():
    robot = Robot()
    assert not robot.at(DUE, off=True).names
    assert robot.memory.prediction.learning is not None, "it learns all the same"
    assert robot.at(DUE + 0.5).names == {"wheels"}
    assert not robot.at(DUE + 1, off=True).names
    assert robot.memory.prediction.warm == {}
    without = Robot(None)
    assert not without.at(DUE).names
    assert without.memory.prediction.learning is None


def test_what_was_requested_at_the_start_has_no_known_beginning():
    robot = Robot()
    robot.memory = Memory()
    assert not robot.at(DUE).names


def test_it_is_given_up_a_while_after_it_is_no_longer_likely():
    robot = Robot()
    robot.at(DUE)
    assert robot.at(69.9).names == {"wheels"}
    gone = robot.at(70.0)
    assert (gone.names, gone.look) == ({"wheels"}, 69.9 + HOLD), "the request did not come"
    assert robot.at(69.9 + HOLD - 0.1).names == {"wheels"}
    assert not robot.at(69.9 + HOLD).names


def test_while_it_is_half_as_likely_as_needed_it_stays():
    departures = (Departure(60.0, ("wheels",)),) * 9 + (Departure(80.0, ()),) * 8
    robot = Robot(Learned({DEVELOPER: {("ears",): departures}}), wheels=replace(WHEELS, idle=Idle(prewarm=0.5)))
    assert robot.at(DUE).names == {"wheels"}
    for prewarmed, until in ((1.01, DUE + HOLD), (1.0, 69.0 + HOLD)):
        other = Robot(robot.learned, wheels=replace(WHEELS, idle=Idle(prewarm=prewarmed)))
        other.memory = robot.memory
        other.at(69.0)
        assert other.memory.prediction.warm["wheels"].until == until


def test_one_that_ends_by_itself_is_left_alone_for_a_while():
    robot = Robot()
    robot.at(DUE)
    assert robot.memory.prediction.warm["wheels"].ran is False
    assert robot.at(67.5).names == {"wheels"}, "its start is still under way"
    assert robot.sees(box(state="running")).at(68.0).names == {"wheels"}
    assert robot.memory.prediction.warm["wheels"].ran is True
    robot.memory = replace(robot.memory, in_flight={"wheels": InFlight(Action(0, Start(container="wheels"), ""), 1.0)})
    assert robot.sees(box()).at(68.5).names == {"wheels"}, "a call on it is under way"
    robot.memory = replace(robot.memory, in_flight={})
    assert not robot.at(69.0).names
    assert robot.memory.prediction.failed == {"wheels": 69.0 + FAILED}
    robot.learned = LEARNED
    assert not robot.at(69.5).names
    robot.memory = replace(robot.memory, prediction=replace(robot.memory.prediction, failed={"wheels": 69.6}))
    assert robot.at(69.6).names == {"wheels"}
    assert robot.memory.prediction.failed == {}


def begun(robot: Robot, now: float = 30.0) -> dict[str, dict[str, float]]:
    """What is known of durations after a start that began at 20."""
    prediction = replace(robot.memory.prediction, begun={"wheels": ("start", 20.0)})
    robot.memory = replace(robot.memory, prediction=prediction)
    robot.at(now)
    return {name: dict(took) for name, took in robot.memory.prediction.learned.took.items()}


def test_a_start_is_measured_until_the_service_is_ready():
    up = {"ready": True, "running_since": 20.0}
    assert begun(Robot().knows(**up)) == {"wheels": {"start": 10.0}}
    robot = Robot().knows(running_since=21.0)
    assert begun(robot) == {}
    assert robot.memory.prediction.begun == {"wheels": ("start", 20.0)}, "it is not ready yet"
    for known in ({"ready": True, "running_since": 19.9}, {"running_since": None}):
        robot = Robot().knows(**known)
        assert begun(robot) == {}
        assert robot.memory.prediction.begun == {}, "that run is over, or an earlier one"
    flying = Robot().knows(**up)
    flying.memory = replace(flying.memory, in_flight={"wheels": InFlight(Action(0, Start(container=""), ""), 1.0)})
    assert begun(flying) == {}
    assert flying.memory.prediction.begun
