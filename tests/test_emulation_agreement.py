"""A simulation and an emulation agree, moment by moment; a simulation can be given what an emulation measured."""

from __future__ import annotations

import pytest
from robots import write_tree

from rorg.manifest.load import load_or_raise
from rorg.model.trace import Trace, TraceEvent
from rorg.model.workload import Distribution
from rorg.sim.agreement import agreement, calibrated, simulated
from rorg.sim.player import EmulatedRun
from rorg.sim.results import RunResult, Sample


def run(*active: str, late: float = 0.0) -> RunResult:
    """One sample a second, each with services named by letters."""
    return RunResult("run", len(active), tuple(Sample(i + 1 + late, 0, 0, frozenset(a)) for i, a in enumerate(active)))


def measured(result: RunResult, **more) -> EmulatedRun:
    return EmulatedRun(result, 0.0, 0, (0.0, 0.0), **{"calls": {}, "starts": {}, "resumes": {}, **more})


def test_all_the_same_agrees_whole():
    found = agreement(run("ab", "a", ""), run("ab", "a", "", late=0.04))
    assert (found.moments, found.services, found.sets, found.differing) == (3, 1.0, 1.0, ())


def test_what_differs_is_counted_by_service_and_by_moment():
    found = agreement(run("ab", "ab", "a", "a"), run("ab", "a", "b", "a"))
    assert found.services == 1 - 3 / 8
    assert found.sets == 0.5
    assert found.differing == (("b", 2), ("a", 1))


def test_services_that_never_run_do_not_make_it_better():
    assert agreement(run("a"), run("")).services == 0.0


def test_moments_that_only_one_has_are_left_out():
    assert agreement(run("a", "a", "b"), run("a", "a")).moments == 2


def test_a_simulation_takes_as_long_as_was_measured(tmp_path):
    tree = write_tree(
        tmp_path / "tree", {"arm": {"idle": {"action": "stop", "linger": "0s"}}, "hand": {"needs": ["arm"]}}
    )
    trace = Trace("short", 20, (TraceEvent(2.2, "developer", "one", ("hand",)), TraceEvent(12.2, "developer", "one")))
    calls = {"start": (3.0,), "stop": (4.0,)}
    found = simulated(load_or_raise(tree), trace, measured(run(), calls=calls), all_on=False)
    states = {round(s.at): s.active for s in found.samples}
    assert found.duration == 20
    assert states[4] == states[5] - {"arm"} == set()
    assert "arm" in states[6]
    assert "hand" in states[9]
    everything = simulated(load_or_raise(tree), trace, measured(run(), calls=calls), all_on=True)
    assert {s.active for s in everything.samples} == {frozenset({"arm", "hand"})}


def test_calibration_takes_what_was_measured():
    found = calibrated(measured(run(), calls={"start": (0.1, 0.3)}, starts={"arm": (2.0,)}, resumes={"arm": (0.5,)}))
    assert found.calls == {"start": Distribution((0.1, 0.3))}
    assert found.of("arm").start == Distribution((2.0,))
    assert found.of("arm").resume == Distribution((0.5,))
    assert found.of("hand").start is None
    assert found.calls["start"].mean == pytest.approx(0.2)
