"""What rorg does with one service in each situation: what its plan does, what it waits for, and until when."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from situations import ARM, BASE, NOW, PROBED, RUN, SPEC, STARTED, box, planned, situation, up

from rorg.core.desired import desire
from rorg.core.digest import Rules, labels
from rorg.core.incremental import plan_all, update_plan
from rorg.core.memory import Attempt, CountedOn, InFlight, Memory, Progress
from rorg.core.observed import LABEL_RULES
from rorg.core.operations import Pause, Start
from rorg.core.peers import Peers
from rorg.core.plan import Action, printed
from rorg.core.situation import Measures, MissingImage
from rorg.core.update import Update
from rorg.core.wanted import Cause
from rorg.model.catalog import Catalog, Idle, Service, Updating
from rorg.model.policy import Policy, Thresholds
from rorg.model.probe import Probe

# -- needs -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("base", "seen", "known", "waits"),
    [
        (BASE, box(), {"ready": False}, "is not ready (10 s)"),
        (PROBED, box(), {"ready": False, "probe": "refused"}, "is not ready (10 s of 30 s): refused"),
        (replace(BASE, ready=Probe("delay", 15.0)), box(), {"ready": False}, "is not ready (10 s of 15 s)"),
        (replace(BASE, ready=Probe("completed", "")), box(), {"ready": False}, "has not ended (10 s)"),
        (BASE, box(), {"ready": False, "running_since": None}, "is not running (ended)"),
        (BASE, box(), {"ready": False, "running_since": None, "error": "bad"}, "is not running (bad)"),
        (
            replace(BASE, restart="never"),
            box(state="exited", exit_code=1),
            {"exited": RUN, "error": "code 1"},
            "code 1",
        ),
    ],
)
def test_what_needs_a_service_waits_until_that_is_ready(base, seen, known, waits):
    progress = {"base": replace(up() if seen.state == "running" else Progress(), **known)}
    (line,) = planned(base, ARM, seen=(seen, box("arm", "exited")), known=progress)
    assert line.startswith(". wait arm base ")
    assert waits in line


def test_a_need_that_begins_or_is_done_is_followed_or_forgotten():
    idle = box("arm", "exited")
    assert planned(BASE, ARM, seen=(box(), idle)) == ["> start arm always on"]
    assert planned(BASE, ARM, seen=(box(state="exited"), idle))[1] == "> start arm always on, after base"
    task = replace(BASE, restart="never", ready=Probe("completed", ""))
    done = {"base": Progress(exited=RUN)}
    assert planned(task, ARM, seen=(box(state="exited", exit_code=0), idle), known=done) == ["> start arm always on"]
    blocked = planned(BASE, ARM, seen=(box(state="exited"), idle), unplugged={"base": "device is missing"})
    assert blocked == [". wait base device is missing", ". wait arm base waits: device is missing"]
    assert planned(ARM, seen=(idle,)) == [". wait arm base is not declared"]
    held = planned(BASE, ARM, seen=(box(), idle), known={"base": up(hung=RUN)}, interlocks={"base": "it moves"})
    assert held == ["> start arm always on", ". wait base interlock: it moves"], "it goes on as before"


@pytest.mark.parametrize(
    ("ready", "known", "until"),
    [
        (Probe("delay", 15.0), {"ready": False}, 105.0),
        (Probe("delay", 15.0), {"ready": False, "running_since": None}, None),
        (Probe("tcp", 80), {"ready": False}, None),
        (None, {"ready": False}, None),
    ],
)
def test_a_delay_tells_when_to_look_again(ready, known, until):
    seen = (box(), box("arm", "exited"))
    found = situation(replace(BASE, ready=ready), ARM, seen=seen, known={"base": up(**known)})
    assert plan_all(found).plans["arm"].waitings[0].until == until


# -- what stands against a start -------------------------------------------------------------------------------


def test_what_conflicts_ends_first():
    rival = replace(ARM, needs=(), conflicts=("base",))
    beside = (box(), box("arm", "exited"))
    assert planned(BASE, rival, seen=beside) == [". wait arm conflicts with base, which is active"]
    ending = planned(BASE, rival, seen=beside, wanted={"arm": (Cause("always_on"),)})
    assert [line.split(",")[-1] for line in ending] == ["# stop base not wanted [SIGTERM; 5 s]", " after base"]
    asleep = replace(BASE, idle=Idle(action="pause"))
    beside = (box(state="paused"), box("arm", "exited"))
    assert planned(asleep, rival, seen=beside, wanted={"arm": (Cause("always_on"),)}) == ["> start arm always on"]


@pytest.mark.parametrize(
    ("rules", "removals", "waits"),
    [
        (Rules(conflicts=("arm",)), False, "conflicts with gone, which is active"),
        (Rules(conflicts=("tool",)), False, ""),
        (Rules(exclusive={"gpu": 1}), False, "waits for gpu, which gone still uses"),
        (Rules(exclusive={"cam": 1}), False, ""),
        (Rules(conflicts=("arm",)), True, "after gone"),
    ],
)
def test_what_is_no_longer_declared_still_counts(rules, removals, waits):
    left = box("gone", rules=labels("robot", "gone", {}, "", rules)[LABEL_RULES])
    arm = replace(ARM, needs=(), exclusive={"gpu": 1})
    lines = planned(arm, seen=(left, box("arm", "exited")), removals=removals)
    (line,) = [line for line in lines if line.split()[2] == "arm"]
    assert waits in line
    assert line.startswith("> start" if not waits or removals else ". wait")


@pytest.mark.parametrize(
    ("units", "capacity", "state", "waits"),
    [
        (1, 1, "running", True),
        (1, 1, "paused", True),
        (1, 1, "exited", False),
        (1, 2, "running", False),
        (2, 2, "running", True),
        (2, 3, "running", False),
    ],
)
def test_an_exclusive_resource_must_have_room(units, capacity, state, waits):
    holder, arm = replace(BASE, exclusive={"gpu": 1}), replace(ARM, needs=(), exclusive={"gpu": units})
    progress = {"base": up() if state == "running" else Progress(exited=RUN)}
    policy = Policy(resources={"gpu": capacity})
    seen = (box(state=state), box("arm", "exited"))
    found = plan_all(situation(holder, arm, seen=seen, known=progress, policy=policy)).plans["arm"]
    assert bool(found.waitings or found.actions[0].after) is waits


def test_a_failed_attempt_is_tried_again_after_its_time():
    later = {"base": Progress(attempts={"start": Attempt(at=NOW + 3, error="busy")}, error="busy")}
    assert planned(BASE, seen=(box(state="exited"),), known=later) == [". wait base start failed: busy; again in 3 s"]
    stalled = {"base": replace(later["base"], exits=3)}
    assert "busy; again in" in planned(BASE, seen=(box(state="exited"),), known=stalled)[0]
    silent = {"base": Progress(attempts={"start": Attempt(at=NOW + 3)})}
    assert planned(BASE, seen=(box(state="exited"),), known=silent) == [
        ". wait base start failed: no effect; again in 3 s"
    ]
    over = {"base": Progress(attempts={"start": Attempt(at=NOW, error="busy")})}
    assert planned(BASE, seen=(box(state="exited"),), known=over) == ["> start base always on"]
    other = {"base": Progress(attempts={"create": Attempt(at=NOW + 3, error="no")})}
    assert planned(BASE, seen=(box(state="exited"),), known=other) == ["> start base always on"]


@pytest.mark.parametrize(("priority", "starts"), [(59, False), (60, True)])
def test_while_admission_is_closed_only_what_matters_starts(priority, starts):
    more = {"measures": Measures(closed="under pressure"), "policy": Policy(pressure=Thresholds(admit=60))}
    lines = planned(BASE, seen=(box(state="exited"),), priorities={"base": priority}, **more)
    assert lines == ["> start base always on" if starts else ". wait base under pressure"]
    assert planned(BASE, seen=(box(),), priorities={"base": priority}, **more) == []
    assert planned(BASE, seen=(box(state="exited"),), measures=Measures(closed="x")) == ["> start base always on"]


def test_an_image_that_is_missing_is_waited_for():
    for failed, code in ((True, "no-image"), (False, "image")):
        found = plan_all(situation(BASE, images={"x": MissingImage("is being pulled", failed)}))
        assert [(w.reason, w.code) for w in found.plan().waitings] == [("image x is being pulled", code)]
    assert planned(BASE, images={"y": MissingImage("is not there", True)}) == [
        "+ create base no container [as base]",
        "> start base always on",
    ]


# -- idling ----------------------------------------------------------------------------------------------------


IDLE: dict[str, Any] = {"wanted": {}}


@pytest.mark.parametrize(
    ("idle", "known", "until"),
    [
        (Idle(), {}, None),
        (Idle(linger=30.0), {"unwanted_since": 95.0}, 125.0),
        (Idle(linger=30.0), {"unwanted_since": None}, 130.0),
        (Idle(linger=5.0), {"unwanted_since": 95.0}, None),
        (Idle(min_active=30.0), {"unwanted_since": 95.0}, 120.0),
        (Idle(min_active=30.0, linger=10.0), {"unwanted_since": 99.0}, 120.0),
        (Idle(min_active=15.0, linger=10.0), {"unwanted_since": 99.0}, 109.0),
        (Idle(min_active=30.0), {"unwanted_since": 95.0, "running_since": None}, None),
    ],
)
def test_an_unwanted_service_lingers_for_its_time(idle, known, until):
    found = plan_all(situation(replace(BASE, idle=idle), seen=(box(),), known={"base": up(**known)}, **IDLE))
    assert [w.until for w in found.plan().waitings] == ([] if until is None else [until])
    assert [a.verb for a in found.plan().actions] == (["stop"] if until is None else [])
    hurried = situation(replace(BASE, idle=idle), seen=(box(),), measures=Measures(hurry=True), **IDLE)
    assert [a.verb for a in plan_all(hurried).plan().actions] == ["stop"]


def test_what_is_needed_outlives_what_needs_it():
    both = (box(), box("arm"))
    assert [line.split()[1:3] for line in planned(BASE, ARM, seen=both, **IDLE)] == [["stop", "arm"], ["stop", "base"]]
    lingers = replace(ARM, idle=Idle(linger=30.0))
    known = {"arm": up("arm", unwanted_since=95.0)}
    assert planned(BASE, lingers, seen=both, known=known, **IDLE) == [
        ". wait arm lingers for 25 s",
        ". wait base not wanted, but arm needs it and is still active",
    ]
    flying = Memory({"base": up()}, in_flight={"arm": InFlight(Action(0, Start(container="arm"), "arm"), 99.0)})
    begins = planned(BASE, ARM, seen=(box(), box("arm", "exited")), memory=flying, **IDLE)
    assert begins == [". wait base not wanted, but arm needs it and is being started"]
    ends = replace(flying, in_flight={"arm": InFlight(Action(0, Pause(container="arm"), "arm"), 99.0)})
    assert planned(BASE, ARM, seen=(box(), box("arm", "exited")), memory=ends, **IDLE)[0].startswith("# stop base")


# -- how a run ends --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("service", "seen", "details"),
    [
        (BASE, box(), "[SIGTERM; 5 s]"),
        (BASE, box(stop_signal="SIGINT"), "[SIGINT; 5 s]"),
        (replace(BASE, spec={**SPEC, "stop_signal": "SIGQUIT"}), box(stop_signal="SIGINT"), "[SIGQUIT; 5 s]"),
        (
            replace(BASE, spec={**SPEC, "stop_signal": "SIGQUIT"}, defaults=("stop_signal",)),
            box(stop_signal="SIGINT"),
            "[SIGINT; 5 s]",
        ),
        (replace(BASE, spec={**SPEC, "stop_signal": "SIGQUIT"}, defaults=("stop_signal",)), box(), "[SIGQUIT; 5 s]"),
        (replace(BASE, spec={**SPEC, "stop_grace_period": 20}), box(), "[SIGTERM; 20 s]"),
        (replace(BASE, spec={**SPEC, "stop_grace_period": 0}), box(), "[SIGTERM; 0 s]"),
        (replace(BASE, spec={**SPEC, "stop_grace_period": -1}), box(), "[SIGTERM; 5 s]"),
        (None, box(spec={**SPEC, "stop_signal": "SIGQUIT", "stop_grace_period": 7}), "[SIGQUIT; 7 s]"),
        (None, box(spec={**SPEC, "stop_signal": "SIGQUIT"}, stop_signal="SIGINT"), "[SIGINT; 5 s]"),
        (None, box(spec={**SPEC, "stop_grace_period": "long"}), "[SIGTERM; 5 s]"),
    ],
)
def test_a_run_is_stopped_as_its_manifest_says_or_its_container(service, seen, details):
    seen = replace(seen, digest=desire(Catalog({"base": service})).digests["base"]) if service else seen
    lines = planned(*([service] if service else [ARM]), seen=(seen,), **IDLE)
    assert lines[0].endswith(details)


@pytest.mark.parametrize(
    ("seen", "known", "more", "why"),
    [
        (box(), up(hung=RUN, error="no answer"), {}, "no answer"),
        (box(), up(hung=RUN), {}, "it does not answer any more"),
        (box(), up(hung="another"), {}, ""),
        (box(), up(), {"restarts": {"base": RUN}}, "restart requested"),
        (box(), up(), {"restarts": {"base": "another"}}, ""),
        (box(), up(), {"unplugged": {"base": "device is missing"}}, "device is missing"),
        (box(state="exited"), Progress(), {"restarts": {"base": RUN}}, ""),
    ],
)
def test_a_wanted_run_ends_only_for_a_reason(seen, known, more, why):
    lines = planned(BASE, seen=(seen,), known={"base": known}, **more)
    stops = [line for line in lines if line.split()[1] == "stop"]
    assert bool(stops) is bool(why)
    assert all(why in line for line in stops)


# -- the same plan, step by step -------------------------------------------------------------------------------


FOLLOWS = replace(ARM, restarts_with=("base",))
ROBOT = (
    BASE,
    FOLLOWS,
    Service("cam", spec=SPEC, exclusive={"gpu": 1}),
    Service("map", spec=SPEC, exclusive={"gpu": 1}, idle=Idle(action="pause", linger=30.0)),
    Service("nav", spec=SPEC, needs=("map",), conflicts=("arm",), interlock=Probe("tcp", 80)),
)
SEEN = (box(), box("arm"), box("cam", "exited"), box("map"), box("nav"))
WANTED = {name: (Cause("always_on"),) for name in ("base", "arm", "map", "nav")}
BEFORE = {"seen": SEEN, "wanted": WANTED}


def remembers(name: str, **changes: Any) -> dict[str, Any]:
    return {"known": {name: up(name, **changes)}}


@pytest.mark.parametrize(
    "change",
    [
        {},
        {"wanted": {**WANTED, "cam": (Cause("always_on"),)}},
        {"wanted": {n: c for n, c in WANTED.items() if n != "base"}},
        {"wanted": {n: c for n, c in WANTED.items() if n != "map"}},
        {"wanted": {n: c for n, c in WANTED.items() if n not in ("nav", "map")}},
        {"wanted": {**WANTED, "nav": (Cause("needed", "x"),)}},
        {"wanted": {}},
        {"urgent": frozenset({"nav"})},
        {"priorities": {"nav": 90}},
        {"interlocks": {"nav": "it moves"}},
        {"measures": Measures(hurry=True)},
        {"restarts": {"base": RUN}},
        {"excluded": frozenset({"map"})},
        {"preempted": {"cam": "map has priority"}},
        {"unplugged": {"base": "device is missing"}},
        {"suspended": "by a person"},
        {"now": 120.0},
        {"seen": SEEN[1:]},
        {"seen": (replace(SEEN[0], state="exited"), *SEEN[1:])},
        {"seen": (*SEEN[:3], replace(SEEN[3], state="paused"), SEEN[4])},
        {"seen": (*SEEN[:2], replace(SEEN[2], state="running"), *SEEN[3:])},
        {"seen": (*SEEN, box("gone"))},
        {"seen": (*SEEN[:4], box("nav", spec={"image": "y"}))},
        remembers("base", ready=False),
        remembers("base", hung=RUN),
        remembers("arm", counted_on=CountedOn(f"arm@{STARTED}", {"base": "an earlier run"})),
        remembers("map", unwanted_since=95.0),
        remembers("map", ready=False),
        remembers("nav", attempts={"stop": Attempt(at=130.0, error="no")}),
        remembers("nav", update=Update(edition="e", quarantined={"e": "late"})),
        {"peers": Peers("head", unowned={"nav": "body has it"})},
    ],
    ids=lambda change: " ".join(change) or "nothing",
)
def test_planning_only_what_has_changed_gives_the_whole_plan(change):
    """In both directions, from each of two situations."""
    one = situation(*ROBOT, **BEFORE)
    two = replace(situation(*ROBOT, **{**BEFORE, **change}), desired=one.desired)
    for before, now in ((one, two), (two, one)):
        kept = plan_all(before)
        touched = now.observed.since(before.observed)
        found, whole = update_plan(kept, now, touched), plan_all(now)
        assert found.plan() == whole.plan()
        for part in ("places", "plans", "no_linger", "volatile", "counting", "queue"):
            assert getattr(found, part) == getattr(whole, part), part


# -- trials ----------------------------------------------------------------------------------------------------


OLD = box(state="exited", id="old", name="base.old", spec={"image": "y"})
NEW = box(previous="old")
TRIAL = "the previous container is kept until "


@pytest.mark.parametrize(
    ("service", "known", "note", "until", "code"),
    [
        (PROBED, {"well_since": None, "ready": False}, "this one is ready (10 s of 30 s)", 120.0, ""),
        (
            replace(BASE, ready=Probe("delay", 15.0)),
            {"well_since": None, "ready": False},
            "this one is ready (10 s of 15 s)",
            105.0,
            "",
        ),
        (BASE, {"well_since": None, "ready": False}, "this one is ready", None, ""),
        (
            replace(BASE, ready=Probe("completed", "")),
            {"well_since": None},
            "this one has ended with exit code 0",
            None,
            "",
        ),
        (BASE, {"well_since": 99.0}, "this one has been well (1 s of 60 s)", 101.0, ""),
        (BASE, {}, "this one has been well (10 s of 60 s)", 150.0, "baking"),
        (PROBED, {"well_since": 99.0}, "this one has been well (1 s of 60 s)", 159.0, "baking"),
        (BASE, {"well_since": 40.0, "unproven_since": 100.0}, "this one is known to be well", None, "baking"),
        (BASE, {"well_since": 40.0}, "all services of the set are healthy", None, "baking"),
    ],
)
def test_a_trial_says_what_it_waits_for(service, known, note, until, code):
    service = replace(service, update=Updating(bake=60.0))
    found = plan_all(situation(service, seen=(NEW, OLD), known={"base": up(**known)})).plan()
    assert found.actions == ()
    (said,) = found.waitings
    assert (printed(said.reason, found.now), said.until, said.code) == (TRIAL + note, until, code)
    unwanted = plan_all(situation(service, seen=(NEW, OLD), known={"base": up(**known)}, **IDLE)).plan()
    assert TRIAL not in unwanted.text()
