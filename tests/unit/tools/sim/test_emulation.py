"""A simulation and an emulation agree, moment by moment; a simulation can be given what an emulation measured. A run
that was disturbed is not valid, and nothing is computed from it."""

from __future__ import annotations

import pytest
from robots import write_tree

from rorg.manifest.load import load_or_raise
from rorg.model.trace import Trace, TraceEvent
from rorg.model.workload import Distribution
from rorg.tools.sim.emulate import Share
from rorg.tools.sim.emulation import Compared, Emulation, agreement, as_json, calibrated, replayed, simulated
from rorg.tools.sim.player import EmulatedRun
from rorg.tools.sim.results import Response, RunResult, Sample
from rorg.tools.sim.validity import Conditions, Cpu, NeverReady, OtherLoad, Starved, flaws

QUIET = Conditions(2, 0.1, {"arm": Cpu(10.0, 9.9)})


def run(*active: str, late: float = 0.0) -> RunResult:
    """One sample a second, each with services named by letters."""
    return RunResult("run", len(active), tuple(Sample(i + 1 + late, 0, 0, frozenset(a)) for i, a in enumerate(active)))


def measured(times: dict[tuple[str, str], tuple[float, ...]], *events: TraceEvent) -> EmulatedRun:
    """A run in which calls took these times."""
    return EmulatedRun(run(), 0.0, 0, (0.0, 0.0), times, events, QUIET)


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


ASKED = Response(2.0, "behaviour", "state", "chat", 0.3)
NEVER = Response(9.0, "behaviour", "state", "chat", None)


@pytest.mark.parametrize(
    ("conditions", "responses", "flaw", "why"),
    [
        (QUIET, (ASKED,), None, ""),
        (Conditions(2, 0.2, {}), (), None, ""),
        (Conditions(2, 0.21, {}), (), OtherLoad(0.21, 2), "other programs used 0.21 of 2 cores, more than 10%"),
        (Conditions(2, 0, {"arm": Cpu(1.0, 0.901), "eyes": Cpu(0.1, 0.05)}), (), None, ""),
        (
            Conditions(2, 0, {"arm": Cpu(10.0, 9.4), "base": Cpu(1.0, 1.2), "eyes": Cpu(10.0, 5.0)}),
            (),
            Starved({"arm": Cpu(10.0, 9.4), "eyes": Cpu(10.0, 5.0)}),
            "2 stand-ins got less than 95% of the CPU that they need (eyes 50%, arm 94%)",
        ),
        (
            QUIET,
            (ASKED, NEVER, ASKED),
            NeverReady((NEVER,), 3),
            "1 of 3 requests never became ready (1 of chat)",
        ),
    ],
)
def test_what_makes_a_run_invalid(conditions, responses, flaw, why):
    found = flaws(conditions, responses)
    assert found == (() if flaw is None else (flaw,))
    assert [one.why for one in found] == ([why] if why else [])


def test_the_cause_comes_before_its_effects():
    found = flaws(Conditions(2, 1.5, {"arm": Cpu(10.0, 5.0)}), (NEVER,))
    assert [one.code for one in found] == ["other-load", "starved", "never-ready"]


def pairs(*cpu: float, conditions: Conditions = QUIET) -> Emulation:
    """Runs that used so many cores, alternately with everything on and with rorg."""
    none = agreement(run(), run())
    found = []
    for cores in cpu:
        result = RunResult("run", 10, (Sample(1, 0, 100, frozenset()),), cpu_seconds=10 * cores)
        made = EmulatedRun(result, 0.0, 0, (0.0, 0.0), {}, (), conditions)
        found.append(Compared(made, none, none, result))
    return Emulation(trace="t", compress=1, engine="process", share=Share(), machine={}, runs=tuple(found))


def test_one_pair_has_no_deviation():
    assert pairs(1.0).reductions == {}
    assert as_json(pairs(1.0, 0.5))["reductions"]["cpu"] == {"mean": 0.5, "least": 0.5, "most": 0.5, "deviation": None}
    two = pairs(1.0, 0.5, 1.0, 0.7).reductions["cpu"]
    assert (two.mean, two.deviation) == pytest.approx((0.4, 0.1414), abs=1e-4)


def test_an_invalid_run_leaves_no_reductions_and_says_why():
    disturbed = pairs(1.0, 0.5).with_run(pairs(1.0, conditions=Conditions(2, 1.0, {})).runs[0])
    found = as_json(disturbed)
    assert found["reductions"] == {}
    assert [run["invalid"] for run in found["runs"][:2]] == [[], []]
    assert [flaw["code"] for flaw in found["runs"][2]["invalid"]] == ["other-load"]
