"""Which actions begin now, and what the memory notes of them: urgent work never queues behind bulk work."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rorg.core.dispatch import STUCK, DispatchLimits, Outcome, begin, finish, forget, freed_at, select
from rorg.core.memory import STALLED_AFTER, InFlight, Memory, Progress
from rorg.core.observed import Container, Observed
from rorg.core.operations import Pause, Signal, Start, Stop
from rorg.core.plan import Action
from rorg.core.update import Update

LIMITS = DispatchLimits(urgent=2, bulk=2, most=5)
NOW = 100.0
RUN = Container("c1", "arm", "arm", "running", started_at="2026-01-01T00:00:00Z")
SEEN = Observed((RUN,), complete=True)
START = Action(0, Start(container="c1", counts_on={"base": "b1"}), "arm")
STOP = Action(0, Stop(container="c1", signal="SIGTERM", grace=5.0, incarnation="c1@then"), "arm")
PAUSE = Action(0, Pause(container="c1"), "arm")


def action(name: str) -> Action:
    """Of a service; its name begins with "u" if a request waits for it."""
    return Action(0, Start(container=name), name, urgent=name.startswith("u"))


def chosen(ready: str, busy: str = "", since: float = NOW - 1, limits: DispatchLimits = LIMITS) -> list[str]:
    in_flight = {name: InFlight(action(name), since) for name in busy.split()}
    return [a.service for a in select(map(action, ready.split()), in_flight, limits, NOW)]


@pytest.mark.parametrize(
    ("ready", "busy", "begun"),
    [
        ("", "", ""),
        ("b1 b2 b3", "", "b1 b2"),
        ("b2 b3", "b1", "b2"),
        ("b3", "b1 b2", ""),
        ("u1 u2 u3 b1 b2", "", "u1 u2 b1"),
        ("u1 b2", "b1", "u1"),
        ("u1 u2", "b1 b2", "u1 u2"),
        ("u2 u3", "u1", "u2"),
        ("b1 b2", "u1", "b1"),
        ("u3 b1 b2", "u1 u2", "b1"),
    ],
)
def test_urgent_work_has_slots_of_its_own_and_bulk_work_fewer_beside_it(ready, busy, begun):
    assert chosen(ready, busy) == begun.split()


@pytest.mark.parametrize(
    ("ready", "busy", "next_one"),
    [
        ("b1 b2 b3 b4", "", "b4"),
        ("u1 u2 b1 b2 b3", "", "b3"),
        ("b2 b3", "u1 b1", "b3"),
        ("u3 b2 b3", "u1 u2 b1", "b2"),
        ("b1 b2", "u1 u2 u3 u4 u5", "b2"),
    ],
)
def test_the_rest_of_a_long_queue_is_not_looked_at(ready, busy, next_one):
    queue = map(action, ready.split())
    list(select(queue, {name: InFlight(action(name), NOW - 1) for name in busy.split()}, LIMITS, NOW))
    assert next(queue).service == next_one


def test_a_list_of_actions_will_do():
    assert [a.service for a in select([action("b1"), action("b2")], {}, LIMITS, NOW)] == ["b1", "b2"]


def test_a_call_that_is_stuck_frees_its_slot_until_there_are_too_many():
    assert chosen("b3 b4 b5", "b1 b2", since=NOW - STUCK + 0.1) == []
    assert chosen("b3 b4 b5", "b1 b2", since=NOW - STUCK) == ["b3", "b4"]
    assert chosen("b5 b6", "b1 b2 b3 b4", since=NOW - STUCK) == ["b5"], "five calls in total"
    assert chosen("b6", "b1 b2 b3 b4 b5", since=NOW - STUCK) == []


def test_the_policy_sets_the_bulk_calls():
    assert chosen("b1 b2 b3 b4", limits=LIMITS.allowing(3)) == ["b1", "b2", "b3"]
    assert LIMITS.allowing(None) is LIMITS


def test_the_next_slot_is_freed_when_the_oldest_live_call_gets_stuck():
    flights = {str(since): InFlight(action("b"), since) for since in (NOW - STUCK, NOW - 2.0, NOW - 1.0)}
    assert freed_at(flights, NOW) == NOW - 2.0 + STUCK
    assert freed_at({}, NOW) is None
    assert freed_at({"old": InFlight(action("b"), NOW - STUCK)}, NOW) is None


def after(memory: Memory, one: Action, error: str = "", **outcome: object) -> Memory:
    """The memory after one attempt."""
    return finish(begin(memory, [one], SEEN, NOW), [Outcome(one, error, **outcome)], NOW)


def test_an_action_is_under_way_until_its_outcome():
    memory = begin(Memory(), [START], SEEN, NOW)
    assert memory.in_flight == {"arm": InFlight(START, NOW)}
    assert memory.of("arm").begun == {"base": "b1"}
    memory = finish(memory, [Outcome(START)], NOW)
    assert memory.in_flight == {}
    assert memory.of("arm").begun == {"base": "b1"}, "until it is seen running"
    assert begin(memory, [], SEEN, NOW) is memory


def test_a_stop_is_noted_before_its_call():
    assert begin(Memory(), [STOP], SEEN, NOW).of("arm").stopped == ("c1@then",)


def test_failures_back_off_and_are_told():
    memory, delays = Memory(), []
    for _ in range(3):
        memory = after(memory, START, "no memory")
        tried = memory.of("arm").attempt(Start)
        delays.append(tried.at - NOW)
    assert delays == [1.0, 2.0, 4.0]
    assert (tried.count, tried.error, memory.of("arm").error) == (STALLED_AFTER, "no memory", "no memory")
    assert memory.of("arm").begun is None, "nothing was started"
    assert memory.of("arm").stalled


def test_another_observation_is_another_attempt():
    memory = after(Memory(), START, "no memory")
    other = Observed((Container("c1", "arm", "arm", "exited", started_at="2026-01-01T00:00:01Z"),), complete=True)
    assert begin(memory, [START], other, NOW).of("arm").attempt(Start).count == 1


def test_the_kind_of_a_failure_is_kept_until_a_success():
    memory = after(Memory(), START, "no image", missing=True, spent=True, unsupported=True)
    tried = memory.of("arm").attempt(Start)
    assert (tried.missing, tried.spent, tried.unsupported) == (True, True, True)
    memory = after(memory, START)
    tried = memory.of("arm").attempt(Start)
    assert (tried.missing, tried.spent, tried.unsupported, tried.at, tried.error) == (False, False, False, 0.0, "")
    assert memory.of("arm").error == ""


def test_an_error_of_a_run_outlives_the_success_of_a_call():
    crashed = Progress(exits=1, error="exit code 1")
    memory = after(after(Memory({"arm": crashed}), PAUSE, "unable to freeze"), PAUSE)
    assert memory.of("arm").error == "unable to freeze", "until the service runs again"
    memory = after(Memory({"arm": crashed}), PAUSE)
    assert memory.of("arm").error == "exit code 1"
    assert memory.of("arm").attempt(Pause).at == 0.0


def test_a_run_has_read_what_it_was_signalled_about():
    signal = Signal(container="c1", signal="SIGHUP", incarnation="c1@now", content={"/map": "2"})
    told = Action(0, signal, "arm")
    before = Progress(update=Update(run="c1@now", content={"/map": "1"}))
    assert after(Memory({"arm": before}), told).of("arm").update.content == {"/map": "2"}
    assert after(Memory({"arm": before}), told, "no such process").of("arm").update.content == {"/map": "1"}
    assert after(Memory({"arm": before}), PAUSE).of("arm").update.content == {"/map": "1"}
    another = Progress(update=Update(run="c1@before", content={"/map": "1"}))
    assert after(Memory({"arm": another}), told).of("arm").update.content == {"/map": "1"}


def test_an_engine_that_refuses_the_start_of_a_trial_refuses_the_change():
    trial = Action(0, replace(START.operation, trial="new"), "arm")
    before = Progress(update=Update(edition="new"))
    assert after(Memory({"arm": before}), trial, "bad option", refused=True).of("arm").update.failed
    assert not after(Memory({"arm": before}), trial, "bad option").of("arm").update.failed


def test_one_end_of_several_actions_leaves_the_others_under_way():
    two = begin(Memory(), [START, action("other")], SEEN, NOW)
    assert finish(two, [Outcome(START)], NOW).in_flight.keys() == {"other"}
    assert finish(two, [Outcome(START), Outcome(action("gone"))], NOW).in_flight.keys() == {"other"}


def test_a_success_leaves_the_error_of_another_operation():
    memory = after(after(Memory(), PAUSE, "unable to freeze"), START, "no memory")
    assert after(memory, START).of("arm").error == "unable to freeze"


def test_a_success_that_changes_nothing_backs_off_too():
    memory = Memory()
    for _ in range(STALLED_AFTER):
        memory = after(memory, START)
    assert memory.of("arm").attempt(Start).at > NOW


def test_failures_are_forgotten_once_nothing_is_left_to_do():
    memory = after(Memory(), START, "no memory")
    assert forget(memory, ["arm"], ["arm"]) is memory
    assert forget(memory, [], []) is memory
    forgotten = forget(memory, ["arm"], []).of("arm")
    assert (forgotten.attempts, forgotten.error) == ({}, "")
    assert forget(begin(memory, [START], SEEN, NOW), ["arm"], []).of("arm").attempts, "a call is under way"
    crashed = Memory({"arm": Progress(exits=1, error="exit code 1", attempts=memory.of("arm").attempts)})
    assert forget(crashed, ["arm"], []).of("arm").error == "exit code 1"
