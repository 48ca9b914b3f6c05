"""The tour guide's day, generated: exactly what was asked for, in the order that its state machine allows."""

from __future__ import annotations

from itertools import pairwise

import pytest
import yaml
from common import ROOT
from hypothesis import given, settings
from hypothesis import strategies as st

from rorg.errors import Invalid
from rorg.manifest.load import load_or_raise
from rorg.manifest.traces import read_trace
from rorg.tools.sim import generate
from rorg.tools.sim.generate import generate_day

CYCLE = yaml.safe_load((ROOT / "tests/cases/tour_cycle.yaml").read_text())
FOLLOWS = {
    "start": {"standby"},
    "standby": {"chat", "return", "charging"},
    "chat": {"standby", "tour", "return"},
    "tour": {"return"},
    "return": {"standby", "charging"},
    "charging": {"standby"},
}


def test_states_request_what_the_work_cycle_says():
    of_actions = {a["name"]: set(a["requests"]) for a in CYCLE["actions"] if a["who"] == "behavioral"}
    assert {s: set(generate.STATES[s]) for s in of_actions} == of_actions
    assert set(generate.STATES) - set(of_actions) == {"start", "charging"}
    assert {n for services in generate.STATES.values() for n in services} <= set(
        load_or_raise(ROOT / "manifests").services
    )


@settings(max_examples=50)
@given(st.integers(0, 40), st.integers(0, 5), st.integers(0, 1000))
def test_a_day_has_so_many_greetings_and_tours_whatever_the_seed(greetings, tours, seed):
    trace = generate_day(7200, max(greetings, tours), tours, seed)
    states = trace.states()
    names = [state for _, _, _, state in states]
    assert (names.count("chat"), names.count("tour")) == (max(greetings, tours), tours)
    assert all(after in FOLLOWS[before] for before, after in pairwise(names))
    assert states[0][0] == 0
    assert states[-1][1] == trace.duration
    assert all(before[1] == after[0] > before[0] for before, after in pairwise(states))


def test_the_same_seed_gives_the_same_day_and_another_one_another():
    assert generate_day(3600, 30, 3, 7) == generate_day(3600, 30, 3, 7)
    assert generate_day(3600, 30, 3, 7).events != generate_day(3600, 30, 3, 8).events


def test_the_battery_is_charged_when_it_is_low_and_the_rest_of_the_day_goes_on():
    states = generate_day(8 * 3600, 200, 10, 1).states()
    charges = [(since, until) for since, until, _, state in states if state == "charging"]
    assert len(charges) == 1
    assert charges[0][1] - charges[0][0] == pytest.approx(1.5 * 3600, rel=0.1)
    assert any(since > charges[0][1] and state == "chat" for since, _, _, state in states)


@pytest.mark.parametrize(("greetings", "tours", "why"), [(300, 3, "they take"), (2, 3, "starts with a greeting")])
def test_what_no_day_can_hold_is_refused(greetings, tours, why):
    with pytest.raises(Invalid, match=why):
        generate_day(3600, greetings, tours, 1)


@pytest.mark.parametrize(("name", "duration", "greetings", "tours"), [("day", 4, 188, 10), ("hour", 1, 30, 3)])
def test_the_traces_of_the_evaluation_are_generated(name, duration, greetings, tours):
    found = read_trace(ROOT / "docs/evaluation" / f"{name}.yaml")
    assert found == generate_day(duration * 3600, greetings, tours, 1, name=name)
