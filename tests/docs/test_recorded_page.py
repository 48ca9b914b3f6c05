"""The table of the simulator's error follows from what was recorded, and from nothing else."""

from __future__ import annotations

import json

import pytest
import recorded_table
from recorded_robots import ROBOTS, busy_robot

from rorg.manifest.load import load_or_raise


def run(calls: dict[str, int], cpu: float, median: float, **more) -> dict:
    waits = {"count": 4, "never": 0, "median": median, "sum": 4 * median, "longest": 2 * median}
    return {"calls": calls, "cpu": cpu, "memory": 100e6, "waits": waits, **more}


AGREED = {"agreement": {"services": 0.99, "sets": 0.9, "differing": {}}}
RECORDED = run({"start": 10, "stop": 10}, 0.5, 1.0)
FOUND = {
    "cores": 2,
    "robots": {
        "arm": {
            "recorded": RECORDED,
            "learnt": run({"start": 10, "stop": 10}, 0.51, 0.99, **AGREED),
            "declared": run({"start": 12, "pause": 8}, 0.4, 0.2, **AGREED),
        }
    },
    "short": {
        "1.5": {
            "recorded": run({"start": 3}, 1.9, 3.0),
            "limited": run({"start": 3}, 2.0, 2.7, short={"seconds": 50.0, "core_seconds": 61.2}),
            "unlimited": run({"start": 3}, 3.0, 1.0),
        }
    },
    "invalid": [],
}


@pytest.mark.parametrize(
    ("simulated", "recorded", "told"),
    [(1.05, 1.0, "+5.0 %"), (0.5, 1.0, "-50.0 %"), (1.0, 1.0, "+0.0 %"), (0.0, 0.0, "0.0 %"), (1.0, 0.0, "-")],
)
def test_an_error_is_relative_to_what_was_recorded(simulated, recorded, told):
    assert recorded_table.error(simulated, recorded) == told


def test_each_figure_is_beside_its_simulations():
    lines = recorded_table.robots_table(FOUND).splitlines()
    assert "| arm | CPU, cores | 0.500 | 0.510 | +2.0 % | 0.400 | -20.0 % |" in lines
    assert "| arm | wait, median, s | 1.00 | 0.99 | -1.0 % | 0.20 | -80.0 % |" in lines
    assert "| arm | engine calls | 20 | 20 | +0.0 % | 20 | +0.0 % |" in lines


def test_calls_differ_by_verb_even_if_their_sum_does_not():
    lines = recorded_table.robots_table(FOUND).splitlines()
    assert "| arm | calls: pause | 0 | 0 | +0 | 8 | +8 |" in lines
    assert "| arm | calls: stop | 10 | 10 | +0 | 0 | -10 |" in lines


def test_a_short_cpu_is_compared_with_and_without_the_limit():
    lines = recorded_table.short_table(FOUND).splitlines()
    assert lines[0].startswith("| burners want | | recorded | simulated, `--cores 2` |")
    assert "| 3 of 2 cores | wait, median, s | 3.00 | 2.70 | -10.0 % | 1.00 | -66.7 % |" in lines
    assert "| 3 of 2 cores | CPU short, s | | 50.0 | | 0 | |" in lines


def test_all_rows_have_as_many_cells_as_their_head():
    for table in (recorded_table.robots_table(FOUND), recorded_table.short_table(FOUND)):
        assert len({line.count("|") for line in table.splitlines()}) == 1


def test_what_was_recorded_is_valid():
    """A file that was made on a busy machine must not be committed."""
    assert json.loads(recorded_table.FILE.read_text())["invalid"] == []


@pytest.mark.parametrize("name", [*ROBOTS, "short"])
def test_robots_to_record_have_valid_manifests_and_a_day_that_names_them(tmp_path, name):
    robot = ROBOTS[name]() if name in ROBOTS else busy_robot(6.0)
    catalog = load_or_raise(robot.write(tmp_path))
    assert {n for ask in robot.day for n in ask.services} <= {*catalog.services, *catalog.groups}
    times = [ask.at for ask in robot.day]
    assert times == sorted(times)
    assert times[-1] <= robot.seconds
