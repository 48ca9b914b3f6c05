"""The figures of docs/evaluation/contention.py: what they are made of, without a measurement."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import contended
import contention
import contention_robot
import pytest
from common import ROOT, wait_for
from foreground import PERIOD, RECORD


def test_each_tick_has_the_latency_until_its_output():
    punctual = [(0.0, 0.002), (0.02, 0.024)]
    assert list(contended.latencies(punctual, 0.02)) == pytest.approx([0.002, 0.004])


def test_a_skipped_tick_waits_for_the_next_output():
    """The first round takes until 0.05, so the ticks at 0.02 and 0.04 have no round of their own."""
    late = list(contended.latencies([(0.0, 0.05), (0.06, 0.063)], 0.02))
    assert late == pytest.approx([0.05, 0.043, 0.023, 0.003])
    assert contended.missed(late, 0.02) == 75.0


def test_an_output_at_the_deadline_is_not_missed():
    assert contended.missed([0.02, 0.021], 0.02) == 50.0


@pytest.mark.parametrize(("part", "value"), [(0.5, 50), (0.95, 95), (0.99, 99), (1.0, 100), (0.001, 1)])
def test_a_percentile_is_one_of_the_values(part, value):
    assert contended.percentile(list(range(100, 0, -1)), part) == value


def test_the_interval_is_that_of_student():
    """Mean 3, standard deviation 1.5811, t of 4 degrees of freedom 2.776."""
    assert contended.estimate([1, 2, 3, 4, 5]) == pytest.approx((3.0, 1.963), abs=1e-3)
    assert contended.estimate([7.0]) == (7.0, None)


def test_a_control_loop_writes_when_it_was_due_and_done(tmp_path):
    """Two seconds would be 100 ticks; all of them have a latency, however busy this machine is."""
    rounds = [(n * PERIOD, n * PERIOD + 0.001) for n in range(100) if n not in (50, 51)]
    (tmp_path / "control").write_bytes(b"".join(RECORD.pack(*one) for one in rounds))
    found = contention.controlled(tmp_path / "control", 0.0, 2.0)
    assert (found["ticks"], found["missed"]) == (100, 2.0)
    assert found["longest"] == pytest.approx(2 * PERIOD + 0.001)


def test_the_control_loop_keeps_its_period(tmp_path):
    file = tmp_path / "control"
    words = [sys.executable, str(ROOT / "tests/support/programs/foreground.py"), "control", str(file)]
    process = subprocess.Popen(words)
    try:
        wait_for(lambda: file.exists() and file.stat().st_size >= 20 * RECORD.size, 60)
    finally:
        process.kill()
        process.wait()
    due = [one[0] for one in RECORD.iter_unpack(file.read_bytes()[: 20 * RECORD.size])]
    steps = [(after - before) / PERIOD for before, after in pairwise(due)]
    assert all(step == pytest.approx(round(step)) and round(step) >= 1 for step in steps)


def test_rounds_differ_and_a_seed_repeats_them():
    one, other = (contention_robot.tour_of(1, number, 10.0) for number in (1, 2))
    assert one == contention_robot.tour_of(1, 1, 10.0) != other
    assert sum(stop.wait * stop.times for stop in one) == pytest.approx(10.0, rel=0.1)
    assert [(stop.state, stop.work) for stop in one] == [(stop.state, stop.work) for stop in other]


def test_the_demand_is_that_of_all_programs_together():
    robot = contention_robot.Robot(3.0)
    cores = os.cpu_count() or 1
    burnt = [robot.container(name, Path("/tmp"))["environment"]["STANDIN_CPU"] for name in robot.all]
    assert sum(map(float, burnt)) == pytest.approx(3.0 * cores, abs=0.01)
    assert robot.needed("tour") < {*robot.all}


def run(way: str, number: int, missed: float) -> dict:
    control = {"missed": missed, "p50": 0.002, "p95": 0.02, "p99": 0.04}
    return {
        "way": way,
        "round": number,
        "seconds": 60.0 + number,
        "control": control,
        "ready": {state: [0.5, 1.5] for _, state, _ in contended.REQUESTS},
        "moves": 2.0,
        "cpu": {"cores": 1.5, "engine": 0.1},
        "memory": {"mean": 2e9},
        "faults": {"minor": 250_000, "major": 3},
        "other": 0.1,
    }


@pytest.mark.slow
def test_the_page_shows_means_with_their_intervals(tmp_path, monkeypatch):
    machine = {
        "cores": 2,
        "cpu": "some CPU",
        "kernel": "6.1",
        "cgroups": 1,
        "docker": "20.10",
        "compose": "Compose 2.26",
    }
    runs = [run(way, number, float(number)) for number in (1, 2, 3) for way in contended.WAYS]
    level = {"demand": 3.0, "machine": machine, "load": 0.1, "repeated": 1, "runs": runs}
    monkeypatch.setattr(contended, "FILE", tmp_path / "some.json")
    monkeypatch.setattr(contended, "PLOT", tmp_path / "some.svg")
    contended.FILE.write_text(json.dumps({"levels": {"3": level}}))
    table = contended.table().splitlines()
    assert "| control loop: deadlines missed (%) " + "| 2.0 ± 2.5 " * 5 + "|" in table
    assert "| from request to ready: greeting (s) " + "| 0.50 ± 0.00 " * 5 + "|" in table
    assert "| from request to ready: second greeting (s) " + "| 1.50 ± 0.00 " * 5 + "|" in table
    assert any("at most 5% of the CPU; 1 runs were repeated" in line for line in table)
    (row,) = contended.headline_rows()
    assert "| 2.0 %; 2.0 % with CPU shares | 2.0 %; 2.0 % with CPU shares and pauses |" in row
    contended.plot()
    assert all(title in contended.PLOT.read_text() for title in contended.WAYS.values())


def test_a_measurement_is_shown_only_if_it_was_valid():
    assert all(level["checked"] for level in contended.measured()["levels"].values())
