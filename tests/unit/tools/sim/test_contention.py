"""Programs slow down in a simulation while the CPU is short: each gets its share, and nothing is left over."""

from __future__ import annotations

from dataclasses import replace

import pytest
from busy_services import SERVICES
from hypothesis import given
from hypothesis import strategies as st
from robots import write_tree

from rorg.manifest.load import load_or_raise
from rorg.model.trace import Trace, TraceEvent
from rorg.model.workload import Behaviour, Distribution, Workload
from rorg.tools.sim.contention import Demand, granted
from rorg.tools.sim.simulate import simulate

DEMANDS = st.dictionaries(
    st.sampled_from("abcdefgh"),
    st.builds(Demand, st.floats(0, 8), st.sampled_from((2, 512, 1024, 2048, 262144))),
    max_size=8,
)
CORES = st.floats(0.5, 16)
CLOSE = 1e-9


@given(DEMANDS, CORES)
def test_nobody_gets_more_than_it_wants_and_all_together_no_more_than_the_cores(demands, cores):
    found = granted(demands, cores)
    assert found.keys() == demands.keys()
    assert all(0 <= found[name] <= one.cores for name, one in demands.items())
    assert sum(found.values()) == pytest.approx(min(cores, sum(one.cores for one in demands.values())))


@given(DEMANDS, CORES)
def test_without_contention_each_gets_exactly_what_it_wants(demands, cores):
    if sum(one.cores for one in demands.values()) <= cores:
        assert granted(demands, cores) == {name: one.cores for name, one in demands.items()}


@given(DEMANDS, CORES)
def test_who_lacks_cpu_gets_no_less_by_its_shares_than_any_other(demands, cores):
    found = granted(demands, cores)
    for name, one in demands.items():
        if found[name] < one.cores - CLOSE:
            mine = found[name] / one.shares
            assert all(found[other] / that.shares <= mine + CLOSE for other, that in demands.items())


def test_an_example():
    """What the lamp does not want, the others divide two to one."""
    demands = {"lamp": Demand(0.2, 1024), "camera": Demand(2.0, 2048), "arm": Demand(1.0, 1024)}
    assert granted(demands, 2.0) == pytest.approx({"lamp": 0.2, "camera": 1.2, "arm": 0.6})


def fixed(value: float) -> Distribution:
    return Distribution((value,))


DAY = Trace(
    "day",
    60.0,
    (
        TraceEvent(0.0, "developer", "arm", ("arm",)),
        TraceEvent(10.0, "developer", "arm"),
        TraceEvent(20.0, "developer", "burn", ("burner",)),
        TraceEvent(25.0, "developer", "arm", ("arm",)),
        TraceEvent(50.0, "developer", "arm"),
    ),
)
LOADS = Workload(services={"arm": Behaviour(start=fixed(2.0), cpu_start=fixed(1.0))}, probed=True)


@pytest.fixture
def catalog(tmp_path):
    return load_or_raise(write_tree(tmp_path / "tree", SERVICES))


def waits(result) -> list[float]:
    return [one.seconds for one in result.responses if one.id == "arm"]


def test_a_start_takes_longer_while_the_cpu_is_short(catalog):
    """Alone it takes a core. Beside a burner with twice its shares it gets two thirds of a core of two."""
    alone, beside = waits(simulate(catalog, DAY, LOADS, 1, cores=2.0))
    assert beside - (alone - 2.0) == pytest.approx(2.0 * 3 / 2, abs=0.02)
    assert waits(simulate(catalog, DAY, LOADS, 1))[1] == pytest.approx(alone, abs=0.02)


def test_cpu_is_what_the_machine_can_give_and_what_lacks_is_told(catalog):
    result = simulate(catalog, DAY, LOADS, 1, cores=2.0)
    assert max(sample.cpu for sample in result.samples) == pytest.approx(2.0)
    assert result.shortage is not None
    assert result.shortage.seconds == pytest.approx(40.0, abs=0.2)
    rest = 40.0 - 3.0  # while the arm comes up, four cores are wanted, otherwise 3 or 3.1
    assert result.shortage.core_seconds == pytest.approx(1.0 * rest + 2.0 * 3.0 + 0.1 * (25 - 3), abs=0.5)


def test_a_program_goes_on_as_fast_as_it_can_once_others_end(catalog):
    """The burner ends three seconds after the arm began: two of its three seconds of waiting are done by then."""
    released = replace(DAY, events=(*DAY.events[:4], TraceEvent(26.5, "developer", "burn"), DAY.events[4]))
    short = simulate(catalog, released, LOADS, 1, cores=2.0)
    alone, beside = waits(short)
    assert alone < beside < alone + 1.0 - 0.2


def test_enough_cores_change_nothing_but_that_it_is_told(catalog):
    enough, unlimited = simulate(catalog, DAY, LOADS, 1, cores=8.0), simulate(catalog, DAY, LOADS, 1)
    assert (enough.shortage.seconds, enough.shortage.core_seconds) == (0.0, 0.0)
    assert replace(enough, shortage=None) == unlimited
