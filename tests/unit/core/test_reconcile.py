"""The calls that lead a service from what is observed to what is declared (rorg/core/reconcile.py, swap.py)."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from situations import BASE, NOW, RUN, SPEC, box, planned, situation, up

from rorg.core.incremental import plan_all
from rorg.core.memory import Attempt, Progress
from rorg.core.objects import found_object, object_labels
from rorg.core.observed import LABEL_PREVIOUS, Container, FoundObjects, Observed
from rorg.core.operations import Create
from rorg.core.plan import Plan
from rorg.core.rollout import failed, renewed
from rorg.core.update import Update
from rorg.model.catalog import Idle, Service
from rorg.model.engines import Capabilities
from rorg.model.objects import EngineObject

OLD = box(spec={"image": "y"}, id="old")
"""`base` as it was declared before, running."""
NEW = box(id="new", previous="old", name="base.new")
PREVIOUS = replace(OLD, state="exited", name="base.old")
IDLE: dict[str, Any] = {"wanted": {}}
DONE = {"base": Progress(stopped=(RUN, f"old@{RUN.partition('@')[2]}"))}


def plan(*services: Service, **more: Any) -> Plan:
    return plan_all(situation(*(services or (BASE,)), **more)).plan()


def calls(*services: Service, **more: Any) -> list[str]:
    """Verb and container of each action, in order."""
    return [f"{a.verb} {a.container}".strip() for a in plan(*services, **more).actions]


# -- a change --------------------------------------------------------------------------------------------------


def test_a_changed_service_is_replaced_and_the_container_before_is_kept():
    assert calls(seen=(OLD,)) == ["create", "rename old", "rename", "stop old", "start"]
    assert calls(seen=(replace(OLD, state="exited"),), known=DONE) == ["create", "rename old", "rename", "start"]
    assert calls(seen=(OLD,), **IDLE) == ["create", "rename old", "rename", "stop old"]


def test_an_engine_without_names_or_with_rolling_changes_needs_fewer_calls():
    no_names = Capabilities(rename=False)
    assert calls(seen=(OLD,), engine=no_names) == ["create", "stop old", "start"]
    rolls = Capabilities(rolls=True)
    assert "stop old" not in calls(seen=(OLD,), engine=rolls), "the start of the new one ends the old one's run"
    assert "stop old" in calls(seen=(OLD,), engine=rolls, **IDLE)


@pytest.mark.parametrize(
    ("name", "same"), [("base", True), ("base.1a2b3c4d", True), ("basement", False), ("other", False)]
)
def test_a_name_that_an_engine_cannot_change_is_a_difference(name, same):
    named = box(name=name)
    verbs = [call.partition(" ")[0] for call in calls(seen=(named,), engine=Capabilities(rename=False))]
    assert ("create" not in verbs) is same
    assert calls(seen=(named,)) == ([] if name == "base" else ["rename base"])


def test_an_option_that_an_engine_cannot_change_in_place_needs_a_new_container():
    limited = replace(BASE, spec={**SPEC, "cpus": 2.0})
    was = box(spec={**SPEC, "cpus": 1.0}, digest="before", live={"cpus": 1.0})
    assert calls(limited, seen=(was,)) == ["update base"]
    fixed = Capabilities(update=False)
    assert "create" in calls(limited, seen=(was,), engine=fixed)
    ignored = box(spec={**SPEC, "cpus": 2.0}, live={"cpus": None})
    assert calls(limited, seen=(ignored,), engine=fixed) == [], "the engine ignores it"


def test_while_a_new_container_is_on_trial_others_are_removed_beside_it():
    trial = {"base": up(well_since=99.5, incarnation=NEW.incarnation)}
    second = box(id="second", name="base.2", state="exited")
    found = plan(seen=(NEW, PREVIOUS, second), known=trial)
    (removal,) = [a for a in found.actions if a.verb == "remove"]
    assert removal.container == "second"
    assert (removal.surplus, bool(removal.part_of)) == (True, False)
    assert any("the previous container is kept" in why for why in found.reasons()["base"])


# -- the way back ----------------------------------------------------------------------------------------------

FAILED = Update(edition="e", quarantined={"e": "it ended"})


def back(*seen: Container, service: Service = BASE, **more: Any) -> Plan:
    desired = situation(service).desired
    update = Update(edition=desired.editions["base"], quarantined={desired.editions["base"]: "it ended"})
    known = {"base": replace(more.pop("progress", up()), update=update)}
    return plan(service, seen=seen, known=known, **more)


def test_a_failed_change_goes_back_and_says_so():
    found = back(NEW, PREVIOUS)
    verbs = [f"{a.verb} {a.container}" for a in found.actions]
    assert verbs == ["stop new", "start old", "remove new"]
    assert {a.reason for a in found.actions} == {"back to the previous container: it ended"}
    (note,) = found.waitings
    assert note.code == "failed"
    assert "`rorg retry base`" in note.reason
    removing = back(replace(NEW, state="removing"), PREVIOUS)
    assert "remove new" not in [f"{a.verb} {a.container}" for a in removing.actions], "it goes already"


def test_what_went_back_runs_on_and_takes_its_name():
    assert [f"{a.verb} {a.container}" for a in back(replace(OLD, name="base.old")).actions] == ["rename old"]
    assert back(OLD).actions == ()
    stopped = back(replace(OLD, state="exited"), progress=Progress(stopped=(OLD.incarnation,)))
    assert [f"{a.verb} {a.container}" for a in stopped.actions] == ["start old"]
    idle = back(OLD, **IDLE)
    assert [f"{a.verb} {a.container}" for a in idle.actions] == ["stop old"]


def test_what_went_back_and_is_removed_when_idle_goes_as_a_whole():
    removed = replace(BASE, idle=Idle(action="remove"))
    found = back(NEW, PREVIOUS, service=removed, **IDLE)
    assert {f"{a.verb} {a.container}" for a in found.actions} == {"stop new", "remove new", "remove old"}
    assert {a.reason for a in found.actions if a.verb == "remove"} == {"not wanted"}
    alone = back(OLD, service=removed, **IDLE)
    assert {f"{a.verb} {a.container}" for a in alone.actions} == {"stop old", "remove old"}


def test_what_cannot_be_made_now_leaves_what_runs_as_it_is():
    denied = {"base": up(attempts={"create": Attempt(at=NOW + 9, error="no space")})}
    found = plan(seen=(OLD,), known=denied)
    assert found.actions == ()
    (why,) = found.reasons()["base"]
    assert "no space" in why
    ended = {"base": Progress(stopped=(OLD.incarnation,), attempts=denied["base"].attempts)}
    assert "start old" in calls(seen=(replace(OLD, state="exited"),), known=ended), "it ran before"
    never = replace(OLD, state="created", started_at="")
    assert "start old" not in calls(seen=(never,), known=ended)


@pytest.mark.parametrize("state", ["running", "exited"])
def test_nothing_goes_back_to_a_container_that_failed_on_trial(state):
    """It is all that was left, as the engine could not start the one before any more."""
    seen, edition = replace(OLD, state=state), situation(BASE).desired.editions["base"]
    bad = replace(up(incarnation=OLD.incarnation), update=Update(edition="bad"))
    step = bad if state == "running" else Progress(stopped=(OLD.incarnation,), update=bad.update)
    now = renewed(failed(step, "it ended", NOW, "old"), edition, NOW)
    made = [a.operation for a in plan(seen=(seen,), known={"base": now}).actions if isinstance(a.operation, Create)]
    assert [LABEL_PREVIOUS in one.labels for one in made] == [False]
    assert "remove old" in calls(seen=(seen,), known={"base": now})
    another = renewed(failed(step, "it ended", NOW, "the other one"), edition, NOW)
    assert "remove old" not in calls(seen=(seen,), known={"base": another}), "the one that rorg went back to"


# -- what a removal leaves -------------------------------------------------------------------------------------


def test_a_second_container_of_a_service_is_removed():
    second = box(id="second", name="base.2", state="exited")
    found = plan(seen=(box(), second))
    assert [(a.verb, a.container, a.reason, a.surplus) for a in found.actions] == [
        ("remove", "second", "a second container of this service", True)
    ]
    changed = plan(seen=(box(), replace(OLD, id="changed", name="base.3", state="exited")))
    assert [(a.verb, a.container, a.reason, a.surplus) for a in changed.actions] == [
        ("remove", "changed", "changed", False)
    ]


@pytest.mark.parametrize(
    ("idle", "keeps"),
    [
        (Idle(action="stop"), True),
        (Idle(action="remove"), False),
        (Idle(action="stop", escalate=(60.0, "remove")), True),
        (Idle(action="pause", escalate=(60.0, "stop")), True),
    ],
)
def test_an_idle_service_keeps_its_container_as_its_policy_says(idle, keeps):
    service = replace(BASE, idle=idle)
    stopped = {"base": Progress(stopped=(RUN,), ceased_since=NOW)}
    assert calls(service, seen=(box(state="exited"),), known=stopped, **IDLE) == ([] if keeps else ["remove base"])


@pytest.mark.parametrize(
    ("idle", "made"),
    [
        (Idle(action="stop"), True),
        (Idle(action="remove"), False),
        (Idle(action="stop", escalate=(60.0, "remove")), False),
        (Idle(action="pause", escalate=(60.0, "stop")), True),
    ],
)
def test_a_container_is_made_ahead_unless_idling_ends_with_its_removal(idle, made):
    assert calls(replace(BASE, idle=idle), **IDLE) == (["create"] if made else [])


# -- ends ------------------------------------------------------------------------------------------------------


def test_a_container_that_can_never_start_again_is_made_anew():
    dead = plan(seen=(box(state="dead"),), known={"base": Progress(stopped=(RUN,))})
    assert [a.verb for a in dead.actions[:2]] == ["create", "remove"]
    assert {a.reason for a in dead.actions[:2]} == {"the engine calls it dead"}
    tried = Attempt(signature=("base", "", ""), spent=True)
    spent = plan(seen=(box(state="exited"),), known={"base": Progress(stopped=(RUN,), attempts={"start": tried})})
    first, second = spent.actions[:2]
    assert (first.verb, first.reason) == ("create", "the engine cannot start it any more")
    assert (second.verb, second.container, second.surplus) == ("remove", "base", True)


def test_a_task_that_ended_runs_again_only_by_a_restart():
    task = replace(BASE, restart="never")
    over = {"base": Progress(exited=RUN, error="ended with exit code 0")}
    ended = box(state="exited", exit_code=0)
    assert calls(task, seen=(ended,), known=over) == []
    assert calls(task, seen=(ended,), known=over, restarts={"base": RUN}) == ["start base"]
    assert calls(task, seen=(ended,), known=over, restarts={"base": "another"}) == []
    crashed = planned(BASE, seen=(ended,), known=over)
    assert crashed == ["> start base always on; ended with exit code 0"]
    assert planned(BASE, seen=(box(state="created", started_at=""),)) == ["> start base always on"]


# -- networks --------------------------------------------------------------------------------------------------

LAB = EngineObject("network", "lab", "robot_lab")
WIRED = replace(BASE, spec={**SPEC, "networks": {"robot_lab": {}}})


@pytest.mark.parametrize(
    ("state", "joined", "found", "asked", "anew"),
    [
        ("exited", "1", "1", True, False),
        ("exited", "1", "2", True, True),
        ("exited", "1", "", True, True),
        ("exited", "1", "", False, False),
        ("exited", "", "2", True, False),
        ("running", "1", "2", True, False),
    ],
)
def test_a_stopped_container_whose_network_was_made_anew_is_made_anew(state, joined, found, asked, anew):
    exists = [found_object("network", "robot_lab", found, object_labels(LAB, "robot"))] if found else []
    objects = FoundObjects({one.key: one for one in exists}, frozenset({LAB.key} if asked else ()), complete=True)
    seen = box(state=state, spec=WIRED.spec, networks={"robot_lab": joined})
    base = situation(WIRED)
    desired = replace(
        base.desired, objects={LAB.subject: LAB}, uses={"base": (LAB.subject,)}, users={LAB.subject: ("base",)}
    )
    known = {"base": up() if state == "running" else Progress(stopped=(RUN,))}
    observed = Observed((seen,), objects=objects, looked={"base": NOW})
    case = situation(WIRED, known=known)
    actions = plan_all(replace(case, desired=desired, observed=observed)).plan().actions
    assert any(isinstance(a.operation, Create) for a in actions) is anew
