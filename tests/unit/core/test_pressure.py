"""The answers to pressure, sample by sample: when use is too much, what is done next, and when it is undone."""

from __future__ import annotations

from dataclasses import replace

import pytest

from rorg.core.pressure import (
    CALM_MOST,
    FLAP,
    MEASURES,
    NONE,
    PATIENCE,
    Chances,
    Pressure,
    Shed,
    advance,
    calm,
    cause,
    excess,
    helps,
    pressed,
    without,
)
from rorg.model.load import Load
from rorg.model.policy import Budget, Thresholds

GIB = 1 << 30
LIMITS = Thresholds(step=1.0, calm=10.0, cpu_some=40.0, memory_some=20.0)
BUDGET = Budget(cpu=2.0, memory=4 * GIB)
USE = {"map": (0.5, GIB), "log": (0.4, GIB)}
QUIET = Load(0.0, 1.0, 4.0, 1 * GIB, 8 * GIB, use=USE)
LOG, MAP = ("log", 0.5, GIB), ("map", 0.6, GIB)


def sample(at: float, cpu: float = 1.0, memory: int = GIB, **more: object) -> Load:
    return replace(QUIET, at=at, cpu=cpu, memory=memory, **more)


def after(state: Pressure, load: Load, **chances: object) -> Pressure:
    return advance(state, LIMITS, BUDGET, load, Chances(**chances))


def test_a_threshold_is_crossed_only_above_it():
    assert pressed(LIMITS, BUDGET, sample(0, 2.0, 4 * GIB)) == {}
    assert pressed(LIMITS, BUDGET, sample(0, 2.1, 4 * GIB + 1)) == {
        "cpu": "2.1 of 2.0 cores in use",
        "memory": "4.0Gi of 4.0Gi of memory in use",
    }
    assert pressed(LIMITS, BUDGET, sample(0, cpu_some=40.0, memory_some=20.0)) == {}
    assert pressed(LIMITS, BUDGET, sample(0, cpu_some=41.0, memory_some=21.0)) == {
        "cpu": "programs waited for the CPU 41 % of the time",
        "memory": "programs waited for memory 21 % of the time",
    }
    unset = replace(LIMITS, cpu_some=None, memory_some=None)
    assert pressed(unset, BUDGET, sample(0, cpu_some=99.0, memory_some=99.0)) == {}


def test_without_a_budget_the_whole_machine_counts():
    load = sample(0, 3.9, 7 * GIB)
    assert pressed(LIMITS, None, load) == pressed(LIMITS, Budget(), load) == {}
    assert set(pressed(LIMITS, None, sample(0, 4.1, 8 * GIB + 1))) == {"cpu", "memory"}


def test_excess_is_what_is_above_the_threshold():
    found = excess(LIMITS, BUDGET, sample(0, 2.5, 5 * GIB))
    assert found == {"cpu": 0.5, "memory": GIB}
    assert excess(LIMITS, BUDGET, sample(0, cpu_some=50.0)) == {"cpu": 0.0}


def test_freeing_helps_if_it_is_a_fair_part_of_the_excess():
    assert helps({"cpu": 0.2}, 0.02, 0)
    assert not helps({"cpu": 0.2}, 0.019, 8 * GIB), "memory is not short"
    assert not helps({"cpu": 2.0}, 0.09, 0)
    assert helps({"cpu": 2.0}, 0.1, 0)
    assert helps({"cpu": 2.0, "memory": 0.0}, 0.0, 8 << 20)
    assert not helps({"memory": 0.0}, 1.0, (8 << 20) - 1)
    assert not helps({}, 1.0, GIB)


def test_the_largest_users_are_named():
    load = sample(0, 2.5, use={"map": (1.0, GIB), "log": (0.4, 2 * GIB), "idle": (0.1, 0), "arm": (0.3, 0)})
    assert cause(load, "cpu") == " (1.0 by map, 0.7 by programs outside rorg, 0.4 by log)"
    load = replace(load, memory=3 * GIB)
    assert cause(load, "memory") == " (2.0Gi by log, 1.0Gi by map)"
    assert cause(load, "cpu", {"idle": (0.1, 0)}) == " (0.7 by programs outside rorg, 0.1 by idle)"
    assert cause(replace(load, use={}), "cpu") == ""


@pytest.mark.parametrize(
    ("change", "is_calm"),
    [
        ({"cpu": 1.7}, True),
        ({"cpu": 1.71}, False),
        ({"memory": int(3.4 * GIB)}, True),
        ({"memory": int(3.41 * GIB)}, False),
        ({"cpu_some": 34.0}, True),
        ({"cpu_some": 34.1}, False),
        ({"memory_some": 17.0}, True),
        ({"memory_some": 17.1}, False),
    ],
)
def test_calm_is_well_below_every_threshold(change, is_calm):
    assert calm(LIMITS, BUDGET, replace(QUIET, **change)) is is_calm


def test_nothing_is_in_force_without_thresholds_or_samples():
    state = Pressure(level=2)
    assert advance(state, None, BUDGET, QUIET, Chances()) is NONE
    assert advance(state, LIMITS, BUDGET, None, Chances()) is NONE


def test_a_sample_counts_once():
    state = replace(after(NONE, sample(5.0, 3.0), useful={"lower-shares"}), level=0)
    assert after(state, sample(5.0, 3.0), useful={"lower-shares"}) is state
    assert after(state, sample(4.0, 3.0), useful={"lower-shares"}) is state


def test_the_mildest_measure_that_helps_is_taken_first():
    state = after(NONE, sample(1.0, 3.0), useful={"end-lingering", "close-admission"})
    assert (state.level, state.skipped, state.pressed) == (2, {"lower-shares"}, ("cpu",))
    assert state.in_force("end-lingering")
    assert not state.in_force("lower-shares")
    assert not state.in_force("stop-paused")
    state = after(state, sample(3.0, 3.0), useful={"lower-shares", "end-lingering"})
    assert (state.level, state.skipped) == (2, frozenset()), "a milder one that helps by now"
    assert state.changed_at == 3.0


def test_a_measure_shows_its_effect_before_the_next_one():
    state = after(NONE, sample(1.0, 3.0), useful={"lower-shares"})
    assert after(state, sample(2.9, 3.0), useful={"end-lingering"}).level == 1
    assert after(state, sample(3.0, 3.0), useful={"end-lingering"}).level == 2


def test_a_shed_service_has_time_to_end():
    state = Pressure(level=5, shed=(Shed("log", 0.5, 0, ""),), changed_at=1.0)
    victim = {"next_shed": lambda _: MAP, "settling": True}
    assert len(after(state, sample(PATIENCE + 0.9, 3.0), **victim).shed) == 1
    assert len(after(state, sample(PATIENCE + 1.0, 3.0), **victim).shed) == 2


def test_nothing_is_concluded_before_use_is_measured():
    state = after(NONE, sample(1.0, 3.0, use={}), useful={"lower-shares"})
    assert (state.level, state.pressed) == (0, ("cpu",))
    assert state.reason == "3.0 of 2.0 cores in use"


def test_shedding_comes_last_and_waits_for_what_begins():
    load, asked = sample(1.0, 3.0), []
    state = after(NONE, load, next_shed=lambda what: asked.append(what) or LOG)
    assert asked == [("cpu",)]
    assert (state.level, [s.service for s in state.shed], state.changed_at) == (len(MEASURES), ["log"], 1.0)
    assert state.shed[0].reason == (
        "shed under pressure: 3.0 of 2.0 cores in use (2.1 by programs outside rorg, 0.5 by log)"
    )
    assert state.restored == {"log": (float("-inf"), 0.0)}
    assert not after(NONE, load, next_shed=lambda _: LOG, beginning=True).shed


def test_pressure_that_nothing_helps_against_is_told():
    state = after(NONE, sample(1.0, 3.0))
    assert (state.helpless, state.level) == (True, 0)
    assert not after(state, sample(2.0)).helpless


def test_what_comes_back_too_much_waits_longer_each_time():
    def shed_at(at: float, back: float, wait: float) -> float:
        state = replace(NONE, restored={"log": (back, wait)})
        return after(state, sample(at, 3.0), next_shed=lambda _: LOG).restored["log"][1]

    assert shed_at(100.0, 50.0, 10.0) == 20.0
    assert shed_at(50.0 + FLAP + 9.9, 50.0, 10.0) == 20.0
    assert shed_at(50.0 + FLAP + 10.0, 50.0, 10.0) == 0.0
    assert shed_at(100.0, 50.0, 200.0) == CALM_MOST


SHED = Pressure(level=5, shed=(Shed("log", 0.5, GIB, ""),), reason="busy", seen=0.0)


def test_a_measure_is_undone_after_calm_has_lasted():
    state = after(Pressure(level=3, skipped=frozenset({"end-lingering"}), reason="busy"), sample(5.0))
    assert (state.calm_since, state.level) == (5.0, 3)
    assert after(state, sample(14.9)).level == 3
    undone = after(state, sample(15.0))
    assert (undone.level, undone.calm_since, undone.changed_at, undone.skipped) == (1, 15.0, 15.0, frozenset())
    assert undone.reason == "busy"
    over = after(undone, sample(25.0))
    assert (over.level, over.reason, over.engaged) == (0, "", False)


def test_calm_that_is_interrupted_begins_again():
    state = after(Pressure(level=1), sample(5.0))
    state = after(state, sample(10.0, 1.9))
    assert state.calm_since is None
    assert after(after(state, sample(12.0)), sample(20.0)).level == 1


def test_a_shed_service_comes_back_if_it_fits():
    state = after(SHED, sample(5.0, 1.5, 3 * GIB))
    back = after(state, sample(15.0, 1.5, 3 * GIB))
    assert (back.shed, back.level, back.restored) == ((), 5, {"log": (15.0, 10.0)})
    assert back.calm_since == back.changed_at == 15.0
    assert after(state, sample(15.0, 1.51, GIB)).shed
    assert after(state, sample(15.0, 1.0, 3 * GIB + 1)).shed
    assert after(state, sample(14.9, 1.0)).shed


def test_a_shed_service_that_flapped_waits_its_time():
    state = after(replace(SHED, level=5, restored={"log": (0.0, 40.0)}), sample(5.0))
    assert after(state, sample(44.9)).shed
    assert not after(state, sample(45.0)).shed


def test_the_last_shed_comes_back_first_and_one_that_is_too_large_holds_up_no_other():
    both = replace(SHED, shed=(Shed("log", 0.5, GIB, ""), Shed("map", 0.6, GIB, "")))
    assert [s.service for s in after(after(both, sample(5.0)), sample(15.0)).shed] == ["log"]
    large = replace(SHED, shed=(Shed("log", 0.5, GIB, ""), Shed("map", 3.0, GIB, "")))
    assert [s.service for s in after(after(large, sample(5.0)), sample(15.0)).shed] == ["map"]


def test_a_more_important_service_comes_back_in_place_of_others():
    state = replace(SHED, shed=(Shed("drive", 0.5, 0, ""),), changed_at=0.0)
    victims = {"below": lambda name: [LOG, MAP] if name == "drive" else []}
    found = after(state, sample(5.0, 1.8), **victims)
    assert [(s.service, s.reason) for s in found.shed] == [
        ("log", "shed under pressure, in place of drive, which matters more")
    ], "one victim is enough"
    assert found.restored["drive"] == (5.0, 10.0)
    assert found.calm_since is None
    assert [s.service for s in after(state, sample(5.0, 2.0), **victims).shed] == ["log"], "it just fits"
    assert [s.service for s in after(state, sample(1.9, 1.8), **victims).shed] == ["drive"], "too early"
    small = {"below": lambda _: [("tiny", 0.001, 0)]}
    assert [s.service for s in after(state, sample(5.0, 1.8), **small).shed] == ["drive"], "it would not fit"
    useless_first = {"below": lambda _: [("tiny", 0.001, 0), LOG]}
    assert [s.service for s in after(state, sample(5.0, 1.8), **useless_first).shed] == ["log"]
    waited = replace(state, restored={"drive": (0.0, 40.0)})
    assert after(waited, sample(5.0, 1.8), **victims).restored["drive"] == (5.0, 40.0)


def test_a_service_that_is_wanted_no_more_is_shed_no_more():
    assert without(SHED, {"log"}).shed == ()
    assert without(SHED, {"map"}).shed == SHED.shed
