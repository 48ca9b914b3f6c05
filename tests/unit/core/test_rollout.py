"""The verdict on a change (rorg/core/rollout.py): each case says exactly which fields change."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import pytest

from rorg.core.desired import Desired, desire
from rorg.core.digest import canonical, declared_fields
from rorg.core.memory import NONE, Attempt, Memory, ProbeResult, Progress
from rorg.core.observed import Container, Observed
from rorg.core.operations import Create, Start
from rorg.core.plan import Action
from rorg.core.probes_in_force import fits, with_probes_in_force
from rorg.core.rollout import (
    came_up_at,
    failed,
    has_come_up,
    is_late_at,
    judged,
    refused,
    renewed,
    retried,
)
from rorg.core.transitions import Evidence
from rorg.core.trial import candidate, is_outlived
from rorg.core.update import LastGood, Update
from rorg.model.catalog import Catalog, Service, Updating
from rorg.model.probe import Probe

SPEC = {"image": "x"}
BASE = Service("base", spec=SPEC)
PROBED = replace(BASE, ready=Probe("tcp", 80, timeout=30.0))
DELAYED = replace(BASE, ready=Probe("delay", 5.0))
WATCHED = replace(BASE, live=Probe("tcp", 80))
NOW, EARLIER = 100.0, 90.0
STARTED = "2026-01-01T12:00:00Z"
RUN = f"aaaaaaaaaaaa@{STARTED}"
EDITION = Update(edition="now", since=80.0)
STARTING = Progress(incarnation=RUN, running_since=EARLIER, update=EDITION)
WELL = replace(STARTING, ready=True, was_ready=True, well_since=EARLIER)
"""Ready for ten seconds; a bake of two seconds ended at 92."""
FAILED = {"start": Attempt(error="no")}
OLD = Container("b" * 64, "base.old", "base", "exited", "2026-01-01T10:00:00Z")


def desired_of(service: Service, **more: Any) -> Desired:
    return replace(desire(Catalog(services={"base": service})), **more)


DIGEST = desired_of(BASE).digests["base"]


def baked(service: Service = BASE, **more: Any) -> dict[str, Any]:
    """Its edition has stayed well."""
    last_good = LastGood(DIGEST, service.ready, service.live)
    return {"update": replace(EDITION, baked="now", well="a" * 64, last_good=last_good, **more)}


def base(state: str = "running", started: str = STARTED, digest: str = DIGEST, **more: Any) -> Container:
    return Container("a" * 64, "base", "base", state, started, digest=digest, **more)


def changes(
    progress: Progress, *seen: Container, service: Service = BASE, looked: float = NOW, sets: Any = None, **more: Any
) -> dict[str, Any]:
    """The fields that differ after the judgement. A look at each container began at `looked`."""
    observed = Observed(seen, looked={c.id: looked for c in seen})
    facts = {"wanted": True, "busy": False, "now": NOW, **more}
    for role, probe in (("ready", service.ready), ("live", service.live)):
        answer = facts.get(role)
        facts[role] = answer and replace(answer, probe=answer.probe or probe)
    desired = desired_of(service, **({} if sets is None else {"sets": sets}))
    found = judged(progress, service, desired, Evidence(observed=observed, **facts))
    values = {f.name: getattr(found, f.name) for f in fields(found)}
    changed = {name: value for name, value in values.items() if value != getattr(progress, name)}
    assert changed or found is progress
    return changed


def said(ok: bool = True, at: float = 99.0, run: str = RUN, failures: int = 1) -> ProbeResult:
    return ProbeResult(run, ok, at, "" if ok else "refused", 0 if ok else failures)


def quarantined(why: str, at: float = NOW, **more: Any) -> dict[str, Any]:
    """Its change has failed, and the container that was tried; nothing else was wrong with it before."""
    return {"update": replace(EDITION, quarantined={"now": why}, rejected="a" * 64, failed_at=at), **more}


# -- the bake --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("more", "changed"),
    [
        ({"now": 91.9}, {}),
        ({"now": 92.0, "looked": 91.9}, {"unproven_since": 92.0}),
        ({"now": 92.0, "looked": 92.0}, None),
    ],
)
@pytest.mark.parametrize("service", [BASE, DELAYED])
def test_a_run_must_be_seen_well_after_its_bake(service, more, changed):
    assert changes(WELL, base(), service=service, **more) == (baked(service) if changed is None else changed)


def test_a_change_bakes_from_its_declaration_on():
    later = replace(WELL, update=replace(EDITION, since=99.5))
    assert changes(later, base(), now=101.4, looked=101.4) == {}
    assert changes(later, base(), now=101.5, looked=101.5)["update"].baked == "now"


@pytest.mark.parametrize(
    ("ready", "more", "changed"),
    [
        (None, {}, {"unproven_since": 92.0}),
        (said(at=91.9), {}, {"unproven_since": 92.0}),
        (said(run="another"), {}, {"unproven_since": 92.0}),
        (said(at=92.0), {}, baked(PROBED)),
        (said(), {"looked": 91.9}, {"unproven_since": 92.0}),
        (said(False), {"now": 121.9}, {"unproven_since": 92.0}),
        (said(False, failures=0), {"now": 122.0, "looked": 122.0}, {"unproven_since": 92.0}),
    ],
)
def test_its_probe_must_answer_after_the_bake(ready, more, changed):
    assert changes(WELL, base(), service=PROBED, ready=ready, **more) == changed


def test_its_live_probe_must_answer_too():
    assert changes(WELL, base(), service=WATCHED) == {"unproven_since": 92.0}
    assert changes(WELL, base(), service=WATCHED, live=said()) == baked(WATCHED)
    assert changes(WELL, base(), service=WATCHED, live=said(False), now=500.0) == {"unproven_since": 92.0}
    both = replace(PROBED, live=WATCHED.live)
    assert changes(WELL, base(), service=both, ready=said()) == {"unproven_since": 92.0}
    assert changes(WELL, base(), service=both, ready=said(), live=said()) == baked(both)
    assert changes(replace(WELL, was_ready=False), base(), service=WATCHED) == baked(WATCHED), "it is not asked yet"


@pytest.mark.parametrize(
    ("known", "seen", "more"),
    [
        ({}, base(), {"wanted": False}),
        ({}, base(), {"busy": True}),
        ({}, base(), {"unplugged": True}),
        ({"update": replace(EDITION, drawn="arm failed")}, base(), {}),
        ({"update": replace(EDITION, baked="now", well="a" * 64)}, base(), {}),
        ({}, base(digest="another"), {}),
        ({"doubted_since": 95.0}, base(), {}),
        ({"running_since": None}, base(), {}),
        ({}, base("paused"), {}),
    ],
    ids=["unwanted", "busy", "unplugged", "drawn", "baked", "another", "doubted", "not yet seen", "paused"],
)
def test_no_verdict_is_due_without_a_run_to_judge(known, seen, more):
    progress = replace(WELL, unproven_since=92.0, **known)
    assert changes(progress, seen, **more) == {"unproven_since": None}
    assert changes(replace(progress, unproven_since=None), seen, **more) == {}
    assert changes(progress, **more) == {"unproven_since": None}, "it has no container"


def test_a_run_that_has_not_read_a_file_says_nothing_about_it():
    reading = replace(WELL, update=replace(EDITION, run=RUN, content={"map": "1"}))
    desired = {"contents": {"base": {"map": "2"}}}
    evidence = Evidence(
        wanted=True,
        observed=Observed((base(),), looked={"a" * 64: NOW}),
        ready=None,
        live=None,
        busy=False,
        now=NOW,
    )
    for on_change, baked in (("restart", ""), ("SIGHUP", ""), ("none", "now")):
        service = replace(BASE, on_change=on_change)
        assert judged(reading, service, desired_of(service, **desired), evidence).update.baked == baked
    assert judged(reading, BASE, desired_of(BASE, contents={"base": {"map": "1"}}), evidence).update.baked == "now"


def test_a_task_that_has_ended_well_has_passed():
    task = replace(BASE, restart="never")
    ended = replace(NONE, incarnation=RUN, exited=RUN, error="ended with exit code 0", update=EDITION)
    assert changes(ended, base("exited", exit_code=0), service=task) == baked(task)
    for seen, service in ((base("exited", exit_code=1), task), (base("exited", exit_code=0), BASE)):
        assert changes(ended, seen, service=service) == {}
    assert changes(replace(ended, exited=""), base("exited", exit_code=0), service=task) == {}


# -- changes of probes and files alone -------------------------------------------------------------------------


PROVEN = replace(EDITION, since=95.0, baked="before", well="a" * 64, last_good=LastGood(DIGEST, None, None))
"""A container that was proven without probes, before its manifest changed at 95."""
TRIED = replace(STARTING, update=PROVEN)


def lost(progress: Progress, why: str, at: float = NOW, **more: Any) -> dict[str, Any]:
    return {"update": replace(progress.update, quarantined={"now": why}, failed_at=at), **more}


def test_a_new_probe_that_does_not_answer_in_time_has_failed_and_takes_no_readiness():
    late = {"service": PROBED, "now": 127.0, "looked": 127.0, "ready": said(False, at=127.0)}
    ready = replace(WELL, update=PROVEN, probe="refused")
    assert changes(ready, base(), **{**late, "now": 126.9}) == {"unproven_since": 97.0}
    assert changes(ready, base(), **late) == lost(ready, "not ready within 30 s: refused", 127.0, probe="")
    assert changes(ready, base(), **{**late, "ready": None}) == {"unproven_since": 97.0}


def test_a_new_run_of_what_was_proven_proves_a_new_probe_wrong_too():
    late = {"service": PROBED, "now": 125.0, "looked": 125.0}
    denied = said(False, at=125.0)
    known = replace(TRIED, probe="refused", exits=1, attempts=FAILED, error="bad")
    found = lost(known, "not ready within 30 s: refused", 125.0, exits=0, attempts={}, error="", probe="")
    assert changes(known, base(), ready=denied, **late) == found
    assert changes(known, base(), ready=denied, **{**late, "now": 124.9}) == {}
    waits = {"unproven_since": 125.0}
    assert changes(known, base(), **late) == waits
    assert changes(known, base(), ready=denied, **{**late, "looked": 124.9}) == waits
    assert changes(replace(known, update=EDITION), base(), ready=denied, **late) == {}, "it was never proven"


def test_what_denies_its_old_probe_after_a_change_of_a_file_is_no_longer_ready():
    as_before = replace(PROVEN, last_good=LastGood(DIGEST, PROBED.ready, None))
    ready = replace(WELL, update=as_before)
    late = {"service": PROBED, "now": 127.0, "looked": 127.0, "ready": said(False, at=127.0)}
    gone = {"ready": False, "was_ready": False, "well_since": None}
    assert changes(ready, base(), **late) == lost(ready, "not ready within 30 s: refused", 127.0, **gone)
    was = replace(STARTING, update=as_before, was_ready=True, probe="refused")
    assert changes(was, base(), service=PROBED) == lost(was, "no longer ready: refused", was_ready=False)
    for update in ({"quarantined": {"now": "bad"}}, {"baked": "now"}, {"well": "b" * 64, "last_good": None}):
        known = replace(was, update=replace(as_before, **update))
        assert changes(known, base(), service=PROBED) == {}
    assert changes(was, base(digest="another"), service=PROBED) == {}


def test_what_was_never_proven_and_denies_a_new_probe_is_no_longer_ready():
    late = {"service": PROBED, "now": 122.0, "looked": 122.0, "ready": said(False, at=122.0)}
    assert changes(WELL, base(), **late) == {"ready": False, "was_ready": False, "well_since": None}
    assert changes(WELL, base(), **{**late, "now": 121.9}) == {"unproven_since": 92.0}


def test_a_new_live_probe_that_denies_has_failed_at_once():
    ready = replace(WELL, update=PROVEN)
    found = changes(ready, base(), service=WATCHED, live=said(False))
    assert found == lost(ready, "did not answer (refused)")
    three = replace(WATCHED, live=Probe("tcp", 80, failures=3))
    assert changes(ready, base(), service=three, live=said(False, failures=2), now=96.0) == {}
    another = replace(said(False), probe=Probe("tcp", 81))
    assert "update" not in changes(ready, base(), service=WATCHED, live=another), "it answers another probe"
    as_before = replace(ready, update=replace(PROVEN, last_good=LastGood(DIGEST, None, WATCHED.live)))
    found = changes(as_before, base(), service=WATCHED, live=said(False))
    assert "update" not in found, "it is restarted instead"


def test_what_was_proven_keeps_its_probes_until_others_are_tried_on_it():
    good = replace(PROBED, live=WATCHED.live)
    update = replace(PROVEN, last_good=LastGood(DIGEST, good.ready, good.live))
    another = replace(BASE, ready=Probe("tcp", 81))
    desired = desired_of(another)
    of_another = base(digest="another", declared=canonical(declared_fields({"image": "y"})))
    assert with_probes_in_force(another, update, of_another, desired) == good, "its own container is still to come"
    assert with_probes_in_force(another, update, base(), desired) is another, "they are tried on it"
    failed_now = replace(update, quarantined={"now": "bad"})
    assert with_probes_in_force(another, failed_now, base(), desired) == good
    made_anew = replace(failed_now, well="b" * 64)
    assert with_probes_in_force(another, made_anew, base(), desired) == good, "somebody removed the one that was proven"
    differs = replace(made_anew, last_good=LastGood("another", good.ready, good.live))
    assert with_probes_in_force(another, differs, base(), desired) is another
    assert with_probes_in_force(another, replace(failed_now, baked="now"), base(), desired) is another
    assert with_probes_in_force(another, failed_now, None, desired) is another


def test_a_probe_that_failed_rejects_no_container():
    update = replace(PROVEN, quarantined={"now": "bad"}, rejected="b" * 64)
    assert not update.is_rejected(DIGEST)
    assert update.is_rejected("another")
    assert not replace(update, rejected="").is_rejected("another")


# -- trials ----------------------------------------------------------------------------------------------------


NEW = base(previous=OLD.id)


def test_the_new_container_is_the_one_with_an_unproven_predecessor():
    assert candidate([NEW, OLD], EDITION) == (NEW, OLD)
    assert candidate([OLD, NEW], EDITION) == (NEW, OLD)
    assert candidate([NEW, OLD], replace(EDITION, proven=NEW.id)) is None
    assert candidate([NEW], EDITION) is None
    assert candidate([base(), OLD], EDITION) is None


def test_what_came_before_what_was_proven_is_on_trial_no_more():
    """It may be kept because others are joined to it."""
    newest = Container("c" * 64, "base", "base", "running", STARTED, digest=DIGEST, previous=NEW.id)
    assert candidate([newest, NEW, OLD], EDITION) == (newest, NEW)
    assert candidate([newest, NEW, OLD], replace(EDITION, proven=newest.id)) is None
    assert candidate([newest, NEW, OLD], replace(EDITION, proven=NEW.id)) == (newest, NEW)


def test_what_would_go_back_past_what_was_proven_since_is_outlived():
    made = Container("c" * 64, "base", "base", "created", "", digest=DIGEST, previous=OLD.id)
    proven = replace(EDITION, proven=NEW.id)
    assert is_outlived(made, [made, NEW, OLD], proven)
    assert not is_outlived(made, [made, NEW, OLD], EDITION), "it is not proven"
    assert not is_outlived(replace(made, started_at=STARTED), [made, NEW, OLD], proven), "it ran"
    assert not is_outlived(replace(made, previous=NEW.id), [made, NEW, OLD], proven)


def test_a_trial_that_stays_well_is_proven():
    assert changes(WELL, NEW, OLD) == baked(proven=NEW.id)
    together = replace(BASE, update=Updating(atomic="motion"))
    assert changes(WELL, NEW, OLD, service=together, sets={"motion": ("base", "arm")}) == baked()
    assert changes(WELL, NEW, OLD, service=together, sets={}) == baked(proven=NEW.id)
    assert changes(replace(WELL, **baked()), NEW, OLD) == baked(proven=NEW.id)
    another = {"update": replace(EDITION, proven=NEW.id)}
    assert changes(WELL, replace(NEW, digest="another"), OLD) == another, "the manifest has changed again"
    assert changes(replace(WELL, exited=RUN, error="bad"), NEW, OLD)["update"].proven == NEW.id
    assert changes(WELL, NEW, replace(OLD, start_number=1, state="running")) == {}, "the previous one came back"


def test_another_container_of_what_was_proven_is_what_to_go_back_to_once_it_has_stayed_well():
    """Somebody removed the one that was proven."""
    before = replace(WELL, update=replace(EDITION, baked="now", well="c" * 64))
    assert changes(before, base()) == baked()
    on_trial = changes(before, base(previous=OLD.id), OLD)["update"]
    assert (on_trial.well, on_trial.proven) == ("a" * 64, "a" * 64)
    late = replace(STARTING, update=before.update)
    assert changes(late, base(), service=PROBED, now=500.0, looked=500.0, ready=said(False, at=500.0)) == {}


def test_what_failed_with_an_earlier_probe_and_then_stayed_well_is_rejected_no_longer():
    before = replace(WELL, update=replace(EDITION, rejected="a" * 64))
    assert changes(before, base(previous=OLD.id), OLD)["update"].rejected == ""
    assert (
        changes(replace(WELL, update=replace(EDITION, rejected="c" * 64)), base(previous=OLD.id), OLD)[
            "update"
        ].rejected
        == "c" * 64
    )


def test_without_a_probe_others_may_rely_on_a_trial_before_its_bake_ends():
    slow = replace(BASE, update=Updating(bake=60.0))
    assert changes(WELL, NEW, OLD, service=slow, now=91.9) == {}
    assert changes(WELL, NEW, OLD, service=slow, now=92.0) == {"unproven_since": 92.0}
    assert changes(WELL, NEW, OLD, service=replace(slow, ready=PROBED.ready), ready=said(), now=92.0) == {}
    assert changes(STARTING, NEW, OLD, service=slow) == {}


@pytest.mark.parametrize(
    ("known", "seen", "service", "why"),
    [
        ({"exited": RUN, "error": "ended with exit code 1"}, "exited", BASE, "ended with exit code 1"),
        ({"hung": RUN, "error": "did not answer"}, "running", WATCHED, "did not answer"),
        ({"hung": RUN}, "running", WATCHED, "it does not answer any more"),
        ({"was_ready": True, "probe": "refused"}, "running", PROBED, "no longer ready: refused"),
    ],
)
def test_a_trial_fails_if_it_ends_hangs_or_is_lost(known, seen, service, why):
    progress = replace(STARTING, exits=1, attempts=FAILED, **known)
    clean = {"exits": 0, "attempts": {}, **({"error": ""} if "error" in known else {})}
    changed = replace(NEW, state=seen, exit_code=1 if seen == "exited" else None)
    assert changes(progress, changed, OLD, service=service) == quarantined(why, **clean)
    assert changes(replace(progress, exited="another"), replace(NEW, state="exited"), OLD) == {}, "it is not noted yet"
    other = replace(changed, digest="another")
    assert changes(progress, other, OLD, service=service) == {}, "it is not what the manifest says now"


def test_a_trial_that_is_not_ready_in_time_fails():
    late = {"service": PROBED, "now": 120.0, "looked": 120.0, "ready": said(False, at=120.0)}
    assert changes(STARTING, NEW, OLD, **late) == quarantined("not ready within 30 s", 120.0)
    assert changes(STARTING, NEW, OLD, **{**late, "now": 119.9}) == {}
    assert changes(STARTING, NEW, OLD, **{**late, "service": DELAYED}) == {}


def test_a_way_back_that_was_not_noted_is_noted_later():
    """An earlier rorg ended after it had started the previous container again."""
    back = replace(OLD, state="running", started_at="2026-01-01T13:00:00Z")
    ended = replace(NEW, state="exited", exit_code=3)
    assert changes(STARTING, back, ended) == quarantined("ended with exit code 3")
    assert changes(STARTING, back, replace(ended, error="no such file")) == quarantined("no such file")
    never = replace(ended, started_at="", state="created")
    assert changes(STARTING, back, never) == {}, "it has run all the time"
    assert changes(STARTING, back, replace(never, error="no such file")) == quarantined("no such file")
    earlier = replace(back, started_at="1970-01-01T13:00:00Z")
    assert changes(STARTING, earlier, ended) == quarantined("ended with exit code 3"), "the clock was set back"
    assert changes(STARTING, replace(back, state="exited"), ended) == {}
    assert changes(STARTING, back, replace(ended, digest="another")) == {}


# -- what others may rely on -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("service", "bake", "up"), [(BASE, 60.0, 92.0), (BASE, 1.0, 91.0), (DELAYED, 60.0, 92.0), (PROBED, 60.0, 90.0)]
)
def test_a_run_has_come_up_when_it_is_ready_or_after_a_moment(service, bake, up):
    service = replace(service, update=Updating(bake=bake))
    assert came_up_at(WELL, service) == up
    assert came_up_at(STARTING, service) is None
    assert not has_come_up(WELL, service, up, up - 0.1)
    assert has_come_up(WELL, service, up, up)
    assert has_come_up(WELL, service, up - 0.1, up + 5) == (service.ready == PROBED.ready)
    assert has_come_up(WELL, service, None, up + 5) == (service.ready == PROBED.ready)
    assert not has_come_up(STARTING, service, NOW, NOW)


def test_only_a_run_with_a_probe_can_be_late():
    assert is_late_at(STARTING, PROBED) == 120.0
    assert is_late_at(WELL, PROBED) == 122.0
    assert is_late_at(STARTING, BASE) is is_late_at(STARTING, DELAYED) is is_late_at(NONE, PROBED) is None


def test_a_container_fits_if_no_option_differs_that_needs_a_new_one():
    declared = '{"image":"x","mem_limit":5}'
    for spec, digest, label, fit in (
        ({"image": "x"}, DIGEST, "", True),
        ({"image": "x"}, "v0:1", '{"image":"x"}', True),
        ({"image": "y"}, "v0:1", '{"image":"x"}', False),
        ({"image": "x", "mem_limit": 6}, "v0:1", declared, True),
        ({"image": "x"}, "v0:1", "", False),
    ):
        service = replace(BASE, spec=spec)
        assert fits(base(digest=digest, declared=label), "base", desired_of(service)) is fit


# -- editions --------------------------------------------------------------------------------------------------


def test_a_new_edition_begins_without_back_off():
    known = replace(NONE, exits=2, attempts=FAILED, error="bad", update=EDITION)
    assert renewed(known, "now", NOW) is known
    begun = replace(NONE, update=replace(EDITION, edition="next", since=NOW))
    assert renewed(known, "next", NOW) == begun
    first = replace(known, update=Update())
    assert renewed(first, "next", NOW) == replace(first, update=Update(edition="next")), "rorg has just begun"


def test_a_failed_edition_is_quarantined_once():
    known = replace(NONE, exits=2, attempts=FAILED, error="bad", update=EDITION)
    found = failed(known, "late", NOW)
    assert found == replace(NONE, update=replace(EDITION, quarantined={"now": "late"}, failed_at=NOW))
    assert failed(found, "again", NOW) is found
    assert failed(replace(found, update=replace(found.update, edition="next")), "bad", NOW).update.quarantined == {
        "now": "late",
        "next": "bad",
    }


def test_only_a_refused_trial_is_a_failure_of_the_change():
    def refusal(operation: Any) -> str:
        return refused(STARTING, Action(0, operation, "base"), "no such device", NOW).update.failed

    assert refusal(Start(container="a", trial="now")) == "no such device"
    trial = Action(0, Start(container="a", trial="now"), "base")
    assert refused(STARTING, trial, "no such device", NOW).update.rejected == "a"
    assert refusal(Start(container="a", trial="before")) == ""
    assert refusal(Start(container="a")) == ""
    assert refusal(Create(name="base", spec={}, labels={}, digest="")) == ""
    unknown = replace(STARTING, update=Update())
    assert refused(unknown, Action(0, Start(container="a"), "base"), "no", NOW) is unknown


def test_a_quarantine_is_lifted_once_per_request():
    late = failed(replace(STARTING, attempts=FAILED), "late", NOW, "a")
    known = Memory(progress={"base": late, "arm": STARTING})
    found = retried(known, {"base": "12:00"})
    assert found.of("base") == replace(STARTING, update=replace(EDITION, lifted="12:00", spared="a"))
    assert found.of("arm") is known.of("arm")
    assert retried(found, {"base": "12:00"}) is found
    assert retried(known, {}) is known
    assert retried(found, {"base": "13:00"}).of("base").update.lifted == "13:00"
