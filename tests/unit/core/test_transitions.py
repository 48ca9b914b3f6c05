"""How the progress of a service follows from what is observed of it (rorg/core/transitions.py): each case says exactly
which fields change. If none does, the progress stays the same object."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import pytest

from rorg.core.memory import NONE, Attempt, CountedOn, ProbeResult, Progress
from rorg.core.observed import Container, Observed
from rorg.core.transitions import REPEATED, Evidence, advanced, doubt_ends
from rorg.core.update import Update
from rorg.model.catalog import Service
from rorg.model.probe import Probe

BASE = Service("base", spec={"image": "x"})
PROBED = Service("base", ready=Probe("tcp", 80, timeout=30.0))
WATCHED = Service("base", live=Probe("tcp", 80, failures=3))
DELAYED = Service("base", ready=Probe("delay", 5.0))
NOW, EARLIER = 100.0, 90.0
START, NEXT_START, BOOT = "2026-01-01T12:00:00Z", "2026-01-01T13:00:00Z", "2026-01-01T11:00:00Z"
RUN, NEXT_RUN = f"aaaaaaaaaaaa@{START}", f"aaaaaaaaaaaa@{NEXT_START}"
STARTING = Progress(incarnation=RUN, running_since=EARLIER, counted_on=CountedOn(RUN))
UP = replace(STARTING, ready=True, was_ready=True, well_since=EARLIER, relied_on=RUN)
"""A wanted service that has been running and ready for ten seconds."""
FAILED = {"start": Attempt(at=NOW, error="ended with exit code 1")}
FORGOTTEN = {"exits": 0, "attempts": {}, "error": ""}


def base(state: str = "running", started: str = START, service: str = "base", **more: Any) -> Container:
    return Container("a" * 64, service, service, state, started, **more)


def after(progress: Progress, *seen: Container, service: Service = BASE, **more: Any) -> Progress:
    evidence = {"wanted": True, "busy": False, "now": NOW, **more}
    for role, probe in (("ready", service.ready), ("live", service.live)):
        answer = evidence.get(role)
        evidence[role] = answer and replace(answer, probe=answer.probe or probe)
    return advanced(progress, service, Evidence(observed=Observed(seen), **evidence))


def changes(progress: Progress, *seen: Container, **more: Any) -> dict[str, Any]:
    """The fields that differ after a pass."""
    found = after(progress, *seen, **more)
    values = {f.name: getattr(found, f.name) for f in fields(found)}
    changed = {name: value for name, value in values.items() if value != getattr(progress, name)}
    assert changed or found is progress
    return changed


def result(ok: bool = True, at: float = 95.0, run: str = RUN, failures: int = 0, message: str = "") -> ProbeResult:
    return ProbeResult(run, ok, at, message, failures)


# -- wanted and idle -------------------------------------------------------------------------------------------


def test_nothing_changes_while_nothing_happens():
    assert changes(UP, base(), now=200.0) == {}
    assert changes(NONE) == {}
    assert changes(replace(NONE, unwanted_since=EARLIER), wanted=False) == {}


def test_a_service_that_is_wanted_or_unwanted_anew_loses_its_back_off():
    failed = replace(NONE, exits=2, exited=RUN, attempts=FAILED, error="bad")
    assert changes(failed, base("created", ""), wanted=False) == {
        **FORGOTTEN,
        "exited": "",
        "unwanted_since": NOW,
        "ceased_since": NOW,
    }
    unwanted = replace(NONE, unwanted_since=EARLIER, attempts=FAILED, error="bad")
    assert changes(unwanted) == {"unwanted_since": None, "attempts": {}, "error": ""}


@pytest.mark.parametrize("state", ["created", "exited", "paused", "inactive"])
def test_an_unwanted_service_has_ceased_since_it_was_first_seen_not_to_run(state):
    unwanted = replace(NONE, unwanted_since=EARLIER, stopped=(RUN,))
    assert after(unwanted, base(state), wanted=False).ceased_since == NOW
    ceased = replace(unwanted, ceased_since=95.0)
    assert after(ceased, base(state), wanted=False).ceased_since == 95.0
    assert after(ceased, base(), wanted=False).ceased_since is None
    assert after(ceased, wanted=False).ceased_since is None, "it has no container"
    assert after(ceased, base(state)).ceased_since is None, "it is wanted again"


def test_an_end_while_unwanted_is_no_failure():
    unwanted = replace(NONE, unwanted_since=EARLIER, ceased_since=EARLIER)
    assert changes(unwanted, base("exited"), wanted=False) == {"stopped": (RUN,)}
    assert changes(unwanted, base("created"), wanted=False) == {}
    assert after(unwanted, base("restarting", exit_code=1), wanted=False).exits == 0


# -- runs ------------------------------------------------------------------------------------------------------


def test_another_run_begins_with_a_clean_slate():
    up = replace(UP, probe="slow", answered=91.0, denied=92.0, ready=True)
    begun = {"incarnation": NEXT_RUN, "running_since": NOW, "probe": "", "answered": None, "denied": None}
    found = changes(up, base(started=NEXT_START), service=PROBED)
    assert found == {
        **begun,
        "ready": False,
        "was_ready": False,
        "well_since": None,
        "relied_on": "",
        "counted_on": CountedOn(NEXT_RUN, {}),
    }


@pytest.mark.parametrize("seen", [(), (base("paused"),), (base("restarting"),)])
def test_a_run_that_does_not_go_on_is_not_ready(seen):
    found = after(replace(UP, probe="slow"), *seen)
    assert (found.running_since, found.ready, found.was_ready, found.well_since) == (None, False, False, None)
    assert (found.relied_on, found.probe, found.incarnation) == ("", "", RUN)
    assert after(replace(STARTING, probe="refused"), *seen).running_since is None, "nor was it before"


def test_a_run_that_is_resumed_must_be_ready_again():
    resumed = after(replace(STARTING, running_since=None), base(), service=PROBED, ready=result())
    assert (resumed.running_since, resumed.ready) == (NOW, False), "the answer is older"


def test_a_run_of_a_minute_is_stable_and_its_failures_are_forgotten():
    failed = replace(UP, exits=2, attempts={**FAILED, "create": Attempt(error="no")}, error="bad")
    assert changes(failed, base(), now=149.9) == {}
    left = {"exits": 0, "error": "", "attempts": {"create": Attempt(error="no")}}
    assert changes(failed, base(), now=150.0) == left
    hung = replace(failed, hung=RUN, well_since=None)
    assert changes(hung, base(), service=WATCHED, now=150.0) == {}


def test_another_container_has_no_part_in_the_failures_of_the_previous_one():
    failed = replace(NONE, exits=2, exited="bbbbbbbbbbbb@" + START, attempts=FAILED, error="bad")
    assert changes(failed, base("created", "")) == {**FORGOTTEN, "exited": ""}
    assert changes(replace(failed, exited=RUN), base("exited", exit_code=1)) == {}
    assert changes(failed) == {}, "it has no container"


# -- exits -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ended", "why"),
    [
        (base("exited", exit_code=3), "ended with exit code 3"),
        (base("restarting", exit_code=3), "ended with exit code 3"),
        (base("exited", exit_code=137, oom_killed=True), "killed: out of memory"),
    ],
)
@pytest.mark.parametrize(("exits", "delay"), [(0, 0.0), (1, 1.0), (2, 2.0), (3, 4.0), (7, 60.0), (50, 60.0)])
def test_each_exit_in_a_row_postpones_the_next_start_further(ended, why, exits, delay):
    known = replace(NONE, exits=exits, crashes=exits, counted_on=CountedOn(RUN))
    assert changes(known, ended) == {
        "exits": exits + 1,
        "crashes": exits + 1,
        "exited": RUN,
        "error": why,
        "attempts": {"start": Attempt(at=NOW + delay, error=why)},
    }


@pytest.mark.parametrize(
    ("known", "seen", "more"),
    [
        ({"exited": RUN}, base("exited"), {}),
        ({"stopped": (RUN,)}, base("exited"), {}),
        ({"begun": {}}, base("exited", ""), {}),
        ({}, base("exited"), {"busy": True}),
        ({}, base("created"), {}),
        ({"counted_on": CountedOn(RUN)}, base("restarting"), {}),
    ],
    ids=["counted", "stopped by rorg", "never started", "a call is under way", "created", "restarting"],
)
def test_no_exit_is_counted_if_there_was_none_or_it_was_meant(known, seen, more):
    assert changes(replace(NONE, **known), seen, **more) == {}


TRIED, PROVEN = Update(edition="now"), Update(edition="now", baked="now")


@pytest.mark.parametrize(
    ("known", "update", "code", "interrupted"),
    [
        ({}, TRIED, 137, 1),
        ({}, TRIED, 143, 1),
        ({}, TRIED, 1, 1),
        ({}, PROVEN, 1, None),
        ({"rebooted": True}, TRIED, 1, 1),
        ({"rebooted": True, "incarnation": RUN}, TRIED, 137, None),
        ({"incarnation": RUN}, TRIED, 137, None),
        ({"begun": {}}, TRIED, 137, None),
        ({}, PROVEN, 137, 0),
        ({}, replace(TRIED, interrupted=REPEATED - 1), 137, REPEATED),
        ({}, replace(TRIED, interrupted=REPEATED), 137, None),
        ({"rebooted": True}, replace(TRIED, interrupted=REPEATED), 1, None),
        ({}, replace(PROVEN, interrupted=REPEATED), 137, REPEATED),
    ],
)
def test_an_end_that_rorg_did_not_see_may_have_another_cause(known, update, code, interrupted):
    """`interrupted` is how often that has been so since the edition is tried; None if the end counts."""
    found = after(replace(NONE, update=update, **known), base("exited", exit_code=code))
    assert (found.exits, RUN in found.stopped) == ((0, True) if interrupted is not None else (1, False))
    assert found.update.interrupted == (update.interrupted if interrupted is None else interrupted)


@pytest.mark.parametrize("known", [{"begun": {}}, {"begun": {}, "incarnation": NEXT_RUN}, {"incarnation": RUN}])
@pytest.mark.parametrize("update", [TRIED, PROVEN])
def test_an_engine_that_did_not_answer_may_have_ended_a_run_that_nobody_had_seen_yet(known, update):
    """It answers the start, and is stopped before anybody looks."""
    progress = replace(NONE, update=update, **known)
    assert after(progress, base("exited", exit_code=2), outage=True).exits == 0
    assert after(progress, base("exited", exit_code=2)).exits == 1
    once = Service("base", restart="never")
    assert after(progress, base("exited", exit_code=2), outage=True, service=once).exits == 1


def test_want_of_memory_is_no_interruption_and_what_ends_for_good_is_over():
    assert after(NONE, base("exited", exit_code=137, oom_killed=True)).exits == 1
    once = Service("base", restart="never")
    assert after(NONE, base("exited", exit_code=137), service=once).exits == 1
    again = replace(NONE, rebooted=True)
    assert after(again, base("exited", exit_code=137), service=once).exits == 0, "it ran when the machine went down"


def test_who_shares_the_processes_of_another_container_ends_with_it():
    joined = Service("base", joins={"core": ("pid",), "net": ("network_mode",)})
    core, ended = base(service="core"), base("exited", exit_code=137)
    assert after(replace(NONE, incarnation=RUN), ended, core, service=joined).exits == 1
    assert changes(NONE, ended, service=joined) == {"stopped": (RUN,)}
    assert changes(NONE, ended, base("exited", service="core"), service=joined) == {"stopped": (RUN,)}
    counted = replace(NONE, counted_on=CountedOn(RUN, {"core": "an earlier run"}))
    assert changes(counted, ended, core, service=joined) == {"stopped": (RUN,)}
    assert changes(NONE, base("created", ""), service=joined) == {}


# -- a run that was being stopped ------------------------------------------------------------------------------


def test_a_run_that_was_being_stopped_is_doubted_until_it_must_have_ended():
    stopped = replace(UP, stopped=(RUN, "another"))
    doubted = replace(after(stopped, base()), relied_on="")
    assert (doubted.doubted_since, doubted.ready, doubted.well_since) == (NOW, False, None)
    assert doubt_ends(doubted, Service("base")) == 109.0, "5 s until it is killed, and a margin"
    assert doubt_ends(doubted, Service("base", spec={"stop_grace_period": 20.0})) == 124.0
    assert doubt_ends(stopped, BASE) is None
    assert changes(doubted, base(), now=108.9) == {}
    over = after(doubted, base(), now=109.0)
    assert (over.doubted_since, over.stopped, over.ready) == (None, ("another",), True)


def test_a_doubt_ends_with_the_run():
    doubted = replace(STARTING, stopped=(RUN,), doubted_since=95.0)
    assert after(doubted, base("exited")).doubted_since is None
    assert after(doubted).doubted_since is None
    assert after(doubted, base(started=NEXT_START)).doubted_since is None
    assert after(doubted, base(), busy=True).doubted_since is None
    assert after(replace(UP, stopped=(RUN,)), base(), busy=True).doubted_since is None


# -- what a run counts on --------------------------------------------------------------------------------------


FOLLOWER = Service("base", restarts_with=("core",))


def core(started: str, state: str = "running") -> Container:
    return Container("c" * 64, "core", "core", state, started)


@pytest.mark.parametrize(
    ("begun", "need", "relied"),
    [
        (None, core(BOOT), f"cccccccccccc@{BOOT}"),
        (None, core(START), f"cccccccccccc@{START}"),
        (None, core(NEXT_START), f"cccccccccccc@{NEXT_START}"),
        (None, core(BOOT, "exited"), f"cccccccccccc@{BOOT}"),
        ({"core": "x", "gone": "y"}, core(NEXT_START), "x"),
        (None, core("", "created"), None),
        (None, None, None),
    ],
)
def test_a_run_counts_on_the_needs_of_its_start(begun, need, relied):
    known = replace(STARTING, begun=begun, counted_on=CountedOn())
    found = after(known, base(), *([need] if need else []), service=FOLLOWER)
    assert found.counted_on == CountedOn(RUN, {} if relied is None else {"core": relied})
    assert found.begun is None


def test_a_need_that_is_added_later_is_taken_as_it_is():
    known = replace(UP, counted_on=CountedOn(RUN, {"gone": "x"}))
    run = f"cccccccccccc@{NEXT_START}"
    assert changes(known, base(), core(NEXT_START), service=FOLLOWER) == {"counted_on": CountedOn(RUN, {"core": run})}
    ended = core(NEXT_START, "exited")
    assert changes(known, base(), ended, service=FOLLOWER) == {"counted_on": CountedOn(RUN, {})}
    counted = replace(UP, counted_on=CountedOn(RUN, {"core": "x"}))
    assert changes(counted, base(), core(NEXT_START), service=FOLLOWER) == {}


def test_only_a_run_that_goes_on_and_is_known_counts_on_anything():
    for seen in (base("exited"), base(brief=True)):
        found = after(replace(NONE, stopped=(RUN,)), seen, core(BOOT), service=FOLLOWER)
        assert found.counted_on == CountedOn()


# -- readiness -------------------------------------------------------------------------------------------------


READY = {"ready": True, "was_ready": True, "well_since": NOW, "relied_on": RUN}


def test_without_a_probe_what_runs_is_ready():
    assert changes(STARTING, base()) == READY


def test_a_delay_is_over_at_its_very_end():
    assert changes(STARTING, base(), service=DELAYED, now=94.9) == {}
    assert changes(STARTING, base(), service=DELAYED, now=95.0) == {**READY, "well_since": 95.0}
    assert changes(UP, base(), service=DELAYED) == {}


@pytest.mark.parametrize(
    ("said", "changed"),
    [
        (None, {}),
        (result(run="another"), {}),
        (result(at=89.9), {}),
        (result(at=90.0), {**READY, "answered": 90.0}),
        (result(False, message="refused"), {"probe": "refused"}),
        (result(False), {}),
    ],
)
def test_a_probe_counts_if_it_began_during_the_run(said, changed):
    assert changes(STARTING, base(), service=PROBED, ready=said) == changed


def test_the_first_success_clears_the_message():
    found = changes(replace(STARTING, probe="refused"), base(), service=PROBED, ready=result())
    assert found == {**READY, "answered": 95.0, "probe": ""}


@pytest.mark.parametrize(
    ("failures", "said", "changed"),
    [
        (2, result(), {"answered": 95.0, "probe": ""}),
        (2, result(False, failures=1, message="no"), {"denied": 95.0, "probe": "no"}),
        (
            2,
            result(False, failures=2, message="no"),
            {"ready": False, "well_since": None, "relied_on": "", "probe": "no"},
        ),
        (0, result(False, failures=9, message="no"), {"denied": 95.0, "probe": "no"}),
    ],
)
def test_readiness_is_lost_after_enough_failures_in_a_row(failures, said, changed):
    service = Service("base", ready=Probe("tcp", 80, failures=failures))
    assert changes(replace(UP, probe="slow"), base(), service=service, ready=said) == changed
    seen = replace(UP, probe="no", denied=95.0, answered=95.0)
    again = changes(seen, base(), service=service, ready=said)
    assert again == {key: value for key, value in changed.items() if value != getattr(seen, key)}
    assert changes(replace(seen, probe=""), base(), service=service, ready=result()) == {}


@pytest.mark.parametrize(
    ("known", "more", "relied"),
    [
        ({"ready": False}, {"now": 119.9}, RUN),
        ({"ready": False}, {"now": 120.0}, ""),
        ({"ready": False, "was_ready": True}, {"now": 95.0}, ""),
        ({"ready": False, "relied_on": "another"}, {"now": 95.0}, ""),
        ({"ready": True, "relied_on": ""}, {"now": 95.0}, RUN),
        ({"ready": True, "unwanted_since": 1.0}, {"wanted": False}, ""),
    ],
    ids=["not asked yet", "late", "lost", "another run", "ready", "unwanted"],
)
def test_a_run_that_was_ready_before_rorg_restarted_is_relied_on_until_it_is_late(known, more, relied):
    progress = replace(
        NONE, incarnation=RUN, running_since=EARLIER, counted_on=CountedOn(RUN), **{"relied_on": RUN, **known}
    )
    assert after(progress, base(), service=PROBED, **more).relied_on == relied


# -- live ------------------------------------------------------------------------------------------------------


def test_a_run_that_stops_answering_counts_as_ended():
    assert changes(UP, base(), service=WATCHED, live=result(False, failures=2)) == {}
    silent = result(False, failures=3, message="no answer")
    error = "did not answer (no answer)"
    hung = {"hung": RUN, "exits": 2, "crashes": 3, "error": error, "well_since": None}
    attempts = {"start": Attempt(at=NOW + 1.0, error=error)}
    known = replace(UP, exits=1, crashes=2)
    assert changes(known, base(), service=WATCHED, live=silent) == {**hung, "attempts": attempts}
    assert after(known, base("paused"), service=WATCHED, live=silent).hung == ""
    for more in ({"busy": True}, {"wanted": False}, {"service": BASE}):
        assert after(known, base(), **{"service": WATCHED, "live": silent, **more}).hung == ""


def test_an_answer_takes_the_count_back():
    hung = replace(UP, hung=RUN, exits=2, crashes=3, attempts=FAILED, error="did not answer", well_since=None)
    assert changes(hung, base(), service=WATCHED, live=result(False, failures=4)) == {}
    answered = {"hung": "", "exits": 1, "crashes": 2, "attempts": {}, "error": "", "well_since": NOW}
    assert changes(hung, base(), service=WATCHED, live=result()) == answered
    assert after(replace(hung, exits=0), base(), service=WATCHED, live=result()).exits == 0


# -- devices ---------------------------------------------------------------------------------------------------


def test_failures_without_the_device_are_forgotten():
    assert changes(replace(UP, exits=2, attempts=FAILED, error="bad"), base(), unplugged=True) == FORGOTTEN
    assert changes(replace(UP, exits=2, error="bad"), base(), unplugged=True) == {"exits": 0, "error": ""}
    assert changes(replace(UP, attempts=FAILED, error="bad"), base(), unplugged=True) == {"attempts": {}, "error": ""}
    assert changes(replace(UP, attempts={"create": Attempt(error="no")}), base(), unplugged=True) == {}


# -- ends by other hands ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("began", [None, {}], ids=["seen running", "not seen running"])
def test_a_trial_that_a_person_stops_is_repeated(began):
    tried = replace(UP, update=TRIED) if began is None else Progress(begun=began, update=TRIED)
    for more in ({"signalled": True}, {}):
        ended = base("exited", exit_code=143, **more)
        found = after(tried, ended)
        assert (found.update.interrupted, found.exits) == ((1, 0) if more else (0, 1))
    known = replace(tried, update=PROVEN)
    assert after(known, base("exited", exit_code=143, signalled=True)).exits == 1, "what is proven is only restarted"


def test_an_outage_right_after_a_start_counts_against_nothing():
    begun = Progress(begun={}, update=TRIED)
    assert after(begun, base("exited", exit_code=137), outage=True).exits == 0
    assert after(begun, base("exited", exit_code=137)).exits == 1


# -- a process that vanished -----------------------------------------------------------------------------------


def test_a_run_whose_process_has_vanished_has_crashed():
    gone = base(vanished=True)
    proven = replace(UP, update=PROVEN)
    found = after(proven, gone)
    assert (found.ready, found.running_since, found.well_since) == (False, None, None)
    assert (found.exits, found.crashes, found.exited) == (1, 1, RUN)
    assert found.error == "the engine calls it running, but its process has ended"
    assert after(found, gone) is found, "it is counted once"
    assert after(found, base("exited", exit_code=137)) is found


def test_a_trial_whose_process_has_vanished_is_repeated_unless_it_must_not_run_twice():
    tried = replace(UP, update=TRIED)
    found = after(tried, base(vanished=True))
    assert (found.exits, found.stopped, found.update.interrupted) == (0, (RUN,), 1)
    assert after(tried, base(vanished=True), service=Service("base", restart="never")).exits == 1
