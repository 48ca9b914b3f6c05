"""A simulation and an emulation agree, moment by moment; a simulation can be given what an emulation measured."""

from __future__ import annotations

import pytest
from robots import write_tree

from rorg.manifest.load import load_or_raise
from rorg.model.trace import Trace, TraceEvent
from rorg.model.workload import Distribution
from rorg.tools.sim.emulation import agreement, calibrated, replayed, simulated
from rorg.tools.sim.player import EmulatedRun
from rorg.tools.sim.results import RunResult, Sample


def run(*active: str, late: float = 0.0) -> RunResult:
    """One sample a second, each with services named by letters."""
    return RunResult("run", len(active), tuple(Sample(i + 1 + late, 0, 0, frozenset(a)) for i, a in enumerate(active)))


def measured(times: dict[tuple[str, str], tuple[float, ...]], *events: TraceEvent) -> EmulatedRun:
    """A run in which calls took these times."""
    return EmulatedRun(run(), 0.0, 0, (0.0, 0.0), times, events)


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


def test_a_moment_is_compared_with_the_one_that_is_nearest():
    often = RunResult("simulated", 2, tuple(Sample(i / 4, 0, 0, frozenset("ab"[i > 5])) for i in range(9)))
    exact = RunResult("emulated", 2, (Sample(1.3, 0, 0, frozenset("a")), Sample(1.4, 0, 0, frozenset("b"))))
    assert agreement(often, exact).sets == 1.0


ARM = {"arm": {"idle": {"action": "stop", "linger": "0s"}}, "hand": {"needs": ["arm"]}}
EVENTS = (TraceEvent(2.2, "developer", "one", ("hand",)), TraceEvent(12.2, "developer", "one"))
TRACE = Trace("short", 20, (TraceEvent(2, "developer", "one", ("hand",)), TraceEvent(12, "developer", "one")))
TIMES = {("start", "arm"): (3.0,), ("start", "hand"): (1.0,), ("stop", "arm"): (4.0,), ("stop", "hand"): (0.1,)}


def test_a_replay_takes_as_long_as_was_measured_and_begins_when_events_were_passed_on(tmp_path):
    catalog = load_or_raise(write_tree(tmp_path / "tree", ARM))
    measured_run = measured(TIMES, *EVENTS)
    found = simulated(catalog, TRACE, measured_run, replayed(measured_run), all_on=False)
    ends = {"arm": (5.2, 16.3), "hand": (6.2, 12.3)}
    for name, (start, end) in ends.items():
        times = [s.at for s in found.samples if name in s.active]
        assert times[0] == pytest.approx(start, abs=0.3)
        assert times[-1] == pytest.approx(end, abs=0.3)


def test_with_everything_on_nothing_changes(tmp_path):
    catalog = load_or_raise(write_tree(tmp_path / "tree", ARM))
    measured_run = measured({}, *EVENTS)
    found = simulated(catalog, TRACE, measured_run, calibrated(measured_run), all_on=True)
    assert {s.active for s in found.samples} == {frozenset({"arm", "hand"})}


def test_calibration_takes_what_was_measured():
    found = calibrated(measured({**TIMES, ("up", "arm"): (2.0,), ("again", "arm"): (0.5, 0.7)}))
    assert found.calls == {"start": Distribution((3.0, 1.0)), "stop": Distribution((4.0, 0.1))}
    assert found.of("arm").start == Distribution((2.0,))
    assert found.of("arm").resume == Distribution((0.5, 0.7))
    assert found.of("hand").start is None
    assert not found.measured
