"""A trace on a simulated robot: what it uses, how long requests take, and that the same seed gives the same."""

from __future__ import annotations

from dataclasses import replace

import pytest
from robots import write_tree

from rorg.manifest.load import load_or_raise
from rorg.model.trace import Trace, TraceEvent
from rorg.model.workload import Behaviour, Distribution, Workload
from rorg.tools.sim.calls import LATENCY
from rorg.tools.sim.simulate import all_on_services, simulate

MIB = 1 << 20
CAMERA = {"resources": {"cpu": 0.5, "memory": "100Mi"}, "idle": {"action": "pause"}}
TWICE = Trace(
    "twice",
    100.0,
    (
        TraceEvent(10.0, "developer", "look", ("camera",)),
        TraceEvent(20.0, "developer", "look"),
        TraceEvent(50.0, "developer", "look", ("camera",)),
        TraceEvent(70.0, "developer", "look"),
    ),
)


def tree(folder, services, **kinds):
    return load_or_raise(write_tree(folder / "tree", services, **kinds))


def fixed(value: float) -> Distribution:
    return Distribution((value,))


def test_what_a_service_uses_is_added_up_exactly(tmp_path):
    """It runs from the end of its start or resume to the end of the pause."""
    result = simulate(tree(tmp_path, {"camera": CAMERA}), TWICE, Workload(), 1)
    begun, paused, resumed = (LATENCY[verb] for verb in ("start", "pause", "resume"))
    running, alive = 10 + paused - begun + 20 + paused - resumed, 90 - begun
    assert result.cpu_seconds == pytest.approx(0.5 * running)
    assert result.byte_seconds == pytest.approx(100 * MIB * alive)
    assert sum(s.cpu for s in result.samples) == pytest.approx(result.cpu_seconds)
    assert result.actions == {"create": 1, "pause": 2, "resume": 1, "start": 1}
    assert not result.violations


def test_samples_do_not_change_the_sums(tmp_path):
    catalog = tree(tmp_path, {"camera": CAMERA})
    often, seldom = (simulate(catalog, TWICE, Workload(), 1, every=every) for every in (0.25, 30.0))
    assert often.cpu_seconds == pytest.approx(seldom.cpu_seconds)
    assert [s.at for s in seldom.samples] == [30.0, 60.0, 90.0, 100.0]
    assert len(often.samples) == 400


def test_idle_and_paused_use_are_as_the_workload_says(tmp_path):
    """Without time-sharing what nobody uses is idle, and so it is while it lingers."""
    workload = Workload(
        services={
            "camera": Behaviour(
                cpu=fixed(1.0),
                cpu_idle=fixed(0.1),
                memory=fixed(8 * MIB),
                memory_idle=fixed(4 * MIB),
                memory_paused=fixed(2 * MIB),
            )
        }
    )
    catalog = tree(tmp_path, {"camera": CAMERA})
    base, rorg = (simulate(catalog, TWICE, workload, 1, all_on=on) for on in (True, False))
    begun = LATENCY["create"] + LATENCY["start"]
    assert base.cpu_seconds == pytest.approx(0.1 * (70 - begun) + 30)
    assert base.byte_seconds == pytest.approx((4 * (70 - begun) + 8 * 30) * MIB)
    assert rorg.samples[-1].memory == 2 * MIB
    assert rorg.samples[-1].paused == {"camera"}


def test_responses_last_until_the_programs_are_up(tmp_path):
    """rorg counts a service without a probe as ready at once; who requested it waits until it does what it is for."""
    workload = Workload(
        services={"camera": Behaviour(start=fixed(3.0), resume=fixed(0.5))}, calls={"resume": fixed(0.2)}
    )
    found = simulate(tree(tmp_path, {"camera": CAMERA}), TWICE, workload, 1).responses
    assert [r.seconds for r in found] == pytest.approx([LATENCY["start"] + 3.0, 0.7])


def test_what_is_requested_while_it_is_being_stopped_has_to_start_again(tmp_path):
    catalog = tree(tmp_path, {"camera": {**CAMERA, "idle": {"action": "stop", "linger": 0}}})
    again = TraceEvent(20.5, "developer", "look", ("camera",))
    trace = replace(TWICE, events=(*TWICE.events[:2], again))
    workload = Workload(services={"camera": Behaviour(start=fixed(3.0), stop=fixed(1.0))})
    _, second = simulate(catalog, trace, workload, 1).responses
    assert second.seconds == pytest.approx(0.5 + LATENCY["stop"] + LATENCY["start"] + 3.0)


def test_what_is_released_too_soon_was_never_ready(tmp_path):
    workload = Workload(others=Behaviour(start=fixed(15.0), resume=fixed(15.0)))
    found = simulate(tree(tmp_path, {"camera": CAMERA}), TWICE, workload, 1).responses
    assert [r.seconds is None for r in found] == [True, False]
    assert found[1].seconds == pytest.approx(LATENCY["resume"] + 15.0)


def test_a_service_requests_once_it_is_ready(tmp_path):
    catalog = tree(
        tmp_path, {"behaviour": {"ready": {"delay": "2s"}}, "camera": CAMERA, "lamp": {"idle": {"action": "pause"}}}
    )
    trace = Trace(
        "one",
        30.0,
        (
            TraceEvent(0.0, "developer", "work", ("behaviour",)),
            TraceEvent(1.0, "behaviour", "behaviour", ("camera",), "look"),
            TraceEvent(20.0, "behaviour", "behaviour", ("lamp",), "shine"),
        ),
    )
    result = simulate(catalog, trace, Workload(), 1)
    begun = LATENCY["start"]
    assert result.responses[1].seconds == pytest.approx(LATENCY["create"] + begun + 2.0 + begun + 0.1 - 1.0)
    assert result.samples[-1].active == {"behaviour", "lamp"}
    assert result.samples[-1].paused == {"camera"}


def test_another_run_of_the_requester_asks_anew(tmp_path):
    catalog = tree(tmp_path, {"behaviour": {}, "camera": CAMERA})
    trace = Trace(
        "one",
        3600.0,
        (
            TraceEvent(0.0, "developer", "work", ("behaviour",)),
            TraceEvent(1.0, "behaviour", "behaviour", ("camera",), "look"),
        ),
    )
    result = simulate(catalog, trace, Workload(services={"behaviour": Behaviour(crashes=10.0)}), 1)
    assert result.actions["start"] > 3
    assert result.samples[-1].active == {"behaviour", "camera"}
    assert {v.code for v in result.violations} == {"unready"}


def test_memory_that_grows_is_given_back_by_another_run(tmp_path):
    catalog = tree(tmp_path, {"camera": {**CAMERA, "idle": {"action": "stop"}}})
    result = simulate(catalog, TWICE, Workload(services={"camera": Behaviour(growth=float(MIB))}), 1)
    at = {s.at: s.memory / MIB for s in result.samples}
    assert at[19.0] == pytest.approx(109, abs=0.2)
    assert at[52.0] == pytest.approx(102, abs=0.2)
    assert at[69.0] == pytest.approx(119, abs=0.2)


def test_who_is_not_ready_in_time_is_told_of_once(tmp_path):
    catalog = tree(tmp_path, {"camera": {**CAMERA, "ready": {"tcp": 80, "timeout": "2s"}}})
    result = simulate(catalog, TWICE, Workload(others=Behaviour(start=fixed(5.0))), 1)
    assert [(v.code, v.service) for v in result.violations] == [("late", "camera")]


def test_what_does_not_fit_is_refused_whole(tmp_path):
    catalog = tree(tmp_path, {"camera": CAMERA, "other": {"conflicts": ["camera"]}})
    trace = replace(TWICE, events=(*TWICE.events[:1], TraceEvent(15.0, "developer", "more", ("other",))))
    result = simulate(catalog, trace, Workload(), 1)
    assert [(v.at, v.code) for v in result.violations] == [(15.0, "refused")]
    assert result.samples[-1].active == {"camera"}
    assert [r.seconds is None for r in result.responses] == [False, True]


def test_pressure_comes_from_what_programs_use(tmp_path):
    """The manifests promise little; the workload takes more than the budget, so the one that matters less goes."""
    catalog = tree(
        tmp_path,
        {"camera": {**CAMERA, "priority": 80}, "extra": {**CAMERA, "priority": 10, "always_on": True}},
        policies={"default": {"budget": {"cpu": 1.0}, "pressure": {}}},
    )
    workload = Workload(services={"camera": Behaviour(cpu=fixed(0.8))})
    result = simulate(catalog, TWICE, workload, 1)
    found = [(v.code, v.service) for v in result.violations]
    assert ("over_budget", "") in found
    assert ("unready", "extra") in found
    assert {s.active for s in result.samples if 15 < s.at <= 20} == {frozenset({"camera"})}
    assert result.samples[-1].active == {"extra"}


def test_everything_on_leaves_out_what_conflicts(tmp_path):
    catalog = tree(tmp_path, {"camera": CAMERA, "another": {"conflicts": ["camera"]}, "third": {}})
    assert all_on_services(catalog, TWICE) == ("camera", "third")
    assert all_on_services(catalog, replace(TWICE, events=())) == ("another", "third")


SPREAD = Workload(
    others=Behaviour(
        cpu=Distribution((0.3,), 0.1),
        memory=Distribution((1e6, 2e6, 3e6)),
        start=Distribution((1.0,), 0.5),
        crashes=20.0,
    )
)


def test_the_same_seed_gives_the_same(tmp_path):
    catalog = tree(tmp_path, {"camera": CAMERA})
    one, same, other = (simulate(catalog, TWICE, SPREAD, seed) for seed in (1, 1, 2))
    assert one == same
    assert one != other


def test_draws_of_one_service_do_not_depend_on_others(tmp_path):
    """So that two policies are tried on the same programs."""
    spread = Workload(services={"camera": Behaviour(start=Distribution((1.0,), 0.5), resume=Distribution((1.0,), 0.5))})
    alone = simulate(tree(tmp_path / "a", {"camera": CAMERA}), TWICE, spread, 1)
    busy = replace(TWICE, events=(TraceEvent(0.0, "developer", "more", ("lamp",)), *TWICE.events))
    beside = simulate(tree(tmp_path / "b", {"camera": CAMERA, "lamp": CAMERA}), busy, spread, 1)
    assert [r.seconds for r in alone.responses] == pytest.approx([r.seconds for r in beside.responses[1:]])
