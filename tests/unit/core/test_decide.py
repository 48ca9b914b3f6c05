"""One pass as a whole (rorg/core/decide.py, assessment.py): holds, interlocks, outages, previews, the next look."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from situations import ARM, BASE, NOW, RUN, SPEC, box, up

from rorg.core.decide import Decision, decide, preview
from rorg.core.desired import desire
from rorg.core.inputs import Inputs
from rorg.core.links import Remote
from rorg.core.memory import Attempt, InFlight, Memory, ProbeResult, Progress
from rorg.core.observed import Container, Observed
from rorg.core.operations import Start
from rorg.core.peers import Peers
from rorg.core.plan import Action
from rorg.core.pressure import Pressure, Shed
from rorg.core.situation import MissingImage
from rorg.core.update import Update
from rorg.model.catalog import Catalog, Hold, Idle, Request, Service
from rorg.model.load import Load
from rorg.model.policy import Policy, Thresholds
from rorg.model.probe import Probe
from rorg.model.units import parse_time

META = Service("developer", meta=True)
WALL = parse_time("2026-02-01T00:00:00Z")
ON = replace(BASE, always_on=True)
LOCK = Probe("tcp", 80, interval=2.0)


def inputs(*services: Service, seen: tuple[Container, ...] = (), **more: Any) -> Inputs:
    declared = {s.name: s for s in (META, *services)}
    facts = {
        "desired": desire(Catalog(services=declared, policy=more.pop("policy", Policy()))),
        "observed": Observed(seen, complete=more.pop("complete", True), looked={c.id: NOW for c in seen}),
        "memory": Memory({c.service: up(c.service) for c in seen if c.state == "running"}),
        "now": NOW,
        "owner": "robot",
        "requests": (),
        "restarts": {},
        "results": {},
        "wall": WALL,
    }
    return Inputs(**{**facts, **more})


def begun(decision: Decision) -> list[str]:
    return [f"{a.verb} {a.service}" for a in decision.begin]


def planned(decision: Decision) -> list[str]:
    return [f"{a.verb} {a.service}" for a in decision.plan.actions]


# -- suspended and held ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("until", "suspended"), [(WALL + 60, True), (WALL, False), (WALL - 1, False)])
def test_while_suspended_everything_is_planned_and_nothing_begins(until, suspended):
    found = decide(inputs(ON, suspended=Hold(until, "the arm is open")))
    assert planned(found) == ["create base", "start base"]
    assert begun(found) == ([] if suspended else ["create base"])
    assert bool(found.situation.suspended) is suspended
    assert found.deadline == (NOW + 60 if suspended else None)


def test_why_and_until_when_it_is_held_is_told():
    held = {"base": Hold(WALL + 60, "maintenance"), "arm": Hold(WALL + 3600), "gone": Hold(WALL + 60)}
    held |= {"developer": Hold(WALL + 60), "map": Hold(WALL)}
    found = decide(inputs(ON, replace(ARM, needs=()), Service("map", spec=SPEC, always_on=True), holds=held))
    assert found.holds == {
        "base": "held until 2026-02-01 00:01:00 UTC: maintenance",
        "arm": "held until 2026-02-01 01:00:00 UTC",
    }
    assert sorted(planned(found)) == ["create arm", "create base", "create map", "start map"]
    assert "developer" in found.situation.wanted
    assert found.deadline == NOW + 60


# -- interlocks ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("result", "refusal"),
    [
        (None, "tcp 80 is being asked"),
        (ProbeResult("", True, NOW - 3.0), ""),
        (ProbeResult("", True, NOW - 3.1), "tcp 80 is being asked"),
        (ProbeResult("", False, NOW, "the arm moves"), "the arm moves"),
        (ProbeResult("", False, NOW - 3.1, "the arm moves"), "tcp 80 is being asked"),
    ],
)
def test_an_interlock_allows_only_by_an_answer_that_is_new(result, refusal):
    results = {} if result is None else {("base", "interlock"): result}
    found = decide(inputs(replace(ON, interlock=LOCK), seen=(box(state="exited"),), results=results))
    assert found.situation.interlocks == {"base": refusal}
    assert begun(found) == ([] if refusal else ["start base"])


# -- pressure --------------------------------------------------------------------------------------------------


def pressed(**more: Any) -> Inputs:
    """`base` was shed for `arm`; the machine is still under pressure."""
    shed = Pressure(level=5, shed=(Shed("base", 1.0, 0, "shed under pressure"),), seen=NOW)
    arm = replace(ARM, needs=(), always_on=True, priority=90)
    policy = Policy(pressure=Thresholds())
    load = Load(NOW, 4.0, 4.0, 0, 1 << 30, use={"arm": (4.0, 0)})
    seen = (box("arm"), box(state="exited"))
    known = Memory({"arm": up("arm")}, pressure=shed)
    return replace(inputs(replace(ON, priority=70), arm, seen=seen, memory=known, load=load, policy=policy), **more)


def test_what_is_shed_is_not_active_and_comes_back_when_pressure_has_gone():
    found = decide(pressed())
    assert found.situation.preempted == {"base": "shed under pressure"}
    assert found.situation.measures.shed == {"base"}
    calm = replace(pressed().memory.pressure, seen=NOW - 10, calm_since=NOW - 60)
    quiet = Load(NOW, 0.0, 4.0, 0, 1 << 30, use={"arm": (0.0, 0)})
    back = decide(pressed(memory=replace(pressed().memory, pressure=calm), load=quiet))
    assert back.memory.pressure.shed == ()
    assert "base" in back.situation.wanted, "admission is repeated"
    assert planned(back) == ["start base"]


def test_nothing_is_concluded_from_load_while_the_engine_does_not_answer():
    quiet = Load(NOW, 0.0, 4.0, 0, 1 << 30, use={"arm": (0.0, 0)})
    calm = replace(pressed().memory.pressure, seen=NOW - 10, calm_since=NOW - 60)
    memory = replace(pressed().memory, pressure=calm)
    silent = replace(pressed().observed, complete=False)
    assert decide(pressed(memory=memory, load=quiet, observed=silent)).memory.pressure == calm
    held = Hold(WALL + 60)
    assert decide(pressed(memory=memory, load=quiet, suspended=held)).memory.pressure == calm


def test_a_shed_service_that_nothing_wants_any_more_is_forgotten():
    catalog = Catalog({"developer": META, "base": BASE}, policy=Policy(pressure=Thresholds()))
    assert decide(pressed(desired=desire(catalog))).memory.pressure.shed == ()


def test_of_two_that_exclude_each_other_only_one_is_kept_as_shed():
    gpu = {"gpu": 1}
    one, two = replace(ON, exclusive=gpu, priority=60), Service("map", spec=SPEC, always_on=True, exclusive=gpu)
    shed = tuple(Shed(n, 1.0, 0, "shed under pressure") for n in ("base", "map"))
    memory = Memory(pressure=Pressure(level=5, shed=shed, seen=NOW))
    load = Load(NOW, 4.0, 4.0, 0, 1 << 30)
    found = decide(inputs(one, two, memory=memory, load=load, policy=Policy(pressure=Thresholds())))
    assert [s.service for s in found.memory.pressure.shed] == ["base", "map"], "either could come back"
    held = {"base": Hold(WALL + 60)}
    found = decide(inputs(one, two, memory=memory, load=load, policy=Policy(pressure=Thresholds()), holds=held))
    assert [s.service for s in found.memory.pressure.shed] == ["map"], "a person holds it anyway"


# -- outages ---------------------------------------------------------------------------------------------------


def test_during_an_outage_nothing_is_planned_and_failures_are_pardoned():
    update = Update(edition="e", quarantined={"e": "it ended"}, failed_at=NOW - 1)
    failed = Progress(exits=2, error="exit code 1", attempts={"start": Attempt(at=NOW + 60)}, update=update)
    memory = Memory({"base": failed}, outage=False)
    silent = decide(inputs(ON, seen=(box(state="exited"),), complete=False, memory=memory))
    assert planned(silent) == begun(silent) == []
    assert silent.memory.outage is True
    assert (silent.memory.of("base").attempts, silent.memory.of("base").update.failed) == ({}, "")
    assert silent.cache is None
    never = decide(inputs(ON, complete=False, memory=replace(memory, outage=None)))
    assert never.memory.outage is None, "it has not answered yet"


# -- other machines --------------------------------------------------------------------------------------------


def test_a_service_of_another_machine_counts_as_it_is_told():
    there = Service("base", machine="body", away="body")
    arm = replace(ARM, always_on=True, machine="head")
    remote = Remote("running", True, True, "Healthy", "Synced", RUN)
    for ready, begins in ((True, ["start arm"]), (False, [])):
        peers = Peers("head", remotes={"base": replace(remote, ready=ready)}, deadline=NOW + 7)
        found = decide(inputs(there, arm, seen=(box("arm", "exited"),), peers=peers))
        assert begun(found) == begins
        assert found.situation.observed.elsewhere["base"].state == "running"
        assert found.deadline == NOW + 7
    alone = decide(inputs(arm, seen=(box("arm", "exited"),), peers=Peers(remotes={"base": remote})))
    assert alone.situation.observed.elsewhere == {}, "this robot has one machine"


def test_what_another_machine_excludes_is_not_active():
    found = decide(inputs(ON, peers=Peers("head", excluded={"base": "held (on body)"})))
    assert found.situation.preempted == {"base": "held (on body)"}


# -- removals --------------------------------------------------------------------------------------------------


def test_a_confirmed_removal_counts_only_while_manifests_are_read():
    more = {"seen": (box(), box("gone")), "policy": Policy(removals="ask"), "confirmed": ("gone",)}
    assert planned(decide(inputs(ON, **more))) == ["stop gone", "remove gone"]
    assert planned(decide(inputs(ON, **more, removals=False))) == []


# -- memory ----------------------------------------------------------------------------------------------------


def test_attempts_are_forgotten_only_of_what_was_seen_and_has_nothing_left_to_do():
    failed = replace(up(), attempts={"pause": Attempt(error="no")}, error="no")
    found = decide(inputs(ON, seen=(box(),), memory=Memory({"base": failed})))
    assert found.memory.of("base").attempts == {}
    waits = Progress(exited=RUN, attempts={"start": Attempt(at=NOW + 5, error="no")}, error="no")
    found = decide(inputs(ON, seen=(box(state="exited"),), memory=Memory({"base": waits})))
    assert found.memory.of("base").attempts.keys() == {"start"}
    assert found.deadline == NOW + 5


def test_the_earliest_moment_of_all_that_is_due_is_the_next_pass():
    assert decide(inputs(ON, seen=(box(),))).deadline is None
    assert decide(inputs(ON, seen=(box(),), restarts={"base": "2026-02-01T00:00:30Z"})).deadline == NOW + 30
    assert decide(inputs(ON, seen=(box(),), restarts={"base": "2026-01-31T23:59:59Z"})).deadline is None
    lease = Request("r", "developer", ("base",), ttl=9.0)
    leased = inputs(BASE, seen=(box(),), requests=(lease,), renewals={lease.key: 1})
    assert decide(leased).deadline == NOW + 9
    later = replace(leased, memory=decide(leased).memory, now=NOW + 4)
    assert decide(later).deadline == NOW + 9, "it goes on"
    assert decide(replace(later, renewals={lease.key: 2})).deadline == NOW + 13, "it was renewed"
    calls = {"arm": InFlight(Action(0, Start(container="arm"), "arm"), NOW - 1)}
    flying = inputs(ON, replace(ARM, always_on=True), seen=(box(), box("arm", "exited")))
    assert decide(replace(flying, memory=replace(flying.memory, in_flight=calls))).deadline == NOW + 4
    lingers = replace(BASE, idle=Idle(linger=30.0))
    known = Memory({"base": up(unwanted_since=NOW - 10)})
    assert decide(inputs(lingers, seen=(box(),), memory=known)).deadline == NOW + 20


# -- a preview -------------------------------------------------------------------------------------------------


def test_a_preview_shows_what_another_tree_would_do():
    """Whatever an interlock said or an image lacked: images are obtained first, and interlocks are asked then."""
    locked = replace(ON, interlock=LOCK)
    said = {("base", "interlock"): ProbeResult("", False, NOW, "the arm moves")}
    read = inputs(locked, seen=(box(),), results=said, images={"y": MissingImage("is being pulled", False)})
    assert begun(decide(read)) == []
    catalog = Catalog({"developer": META, "base": replace(locked, spec={"image": "y"})})
    found = preview(read, read.memory, desire(catalog))
    assert planned(found) == ["create base", "rename base", "rename base", "stop base", "start base"]
    assert not found.plan.waitings
    gone = preview(replace(read, removals=False), read.memory, desire(Catalog({"developer": META, "arm": ARM})))
    assert [a.verb for a in gone.plan.actions if a.service == "base"] == ["stop", "remove"]
