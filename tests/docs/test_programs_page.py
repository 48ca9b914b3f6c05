"""The robot of real programs in docs/evaluation: its tree, and what follows from its measurements. Only `make programs`
measures."""

from __future__ import annotations

import json

import evaluate
import programmed
import pytest

from rorg.manifest.traces import read_trace, trace_text
from rorg.manifest.workloads import read_workload

REMEDY = "try `make evaluation`"


def test_each_program_is_requested_by_some_state_or_always():
    robot = programmed.robot()
    (standing,) = robot.requests
    asked = {*standing.services, *(name for names in programmed.STATES.values() for name in names)}
    assert asked == set(programmed.programs())


def test_trace_and_workload_are_current():
    assert programmed.TRACE.read_text() == trace_text(programmed.hour()), REMEDY
    assert programmed.WORKLOAD.read_text() == programmed.workload_text(programmed.load()), REMEDY


def test_the_workload_has_each_measured_value(tmp_path):
    """The microphone is used in standby and greet."""
    found, file = programmed.load(), tmp_path / "workload.yaml"
    file.write_text(programmed.workload_text(found))
    microphone = read_workload(file).of("microphone")
    windows = [one["windows"] for one in found["rounds"]]
    used = [w[state]["services"]["microphone"] for w in windows for state in ("standby", "greet")]
    idle = [w["idle"]["services"]["microphone"] for w in windows]
    assert microphone.cpu.values == tuple(one["cpu"] for one in used)
    assert microphone.memory.values == tuple(one["memory"] for one in used)
    assert microphone.cpu_idle.values == tuple(one["cpu"] for one in idle)
    for what in programmed.TIMES:
        seconds = [s for one in found["rounds"] for s in one["times"]["services"]["microphone"][what]]
        assert getattr(microphone, what).values == pytest.approx(seconds, abs=1e-3)


def test_measurements_of_a_busy_machine_are_refused(tmp_path, monkeypatch):
    found = json.loads(programmed.FILE.read_text())
    found["rounds"][1]["invalid"] = ["tour: other programs used 1.20 of 2 cores, more than 10%"]
    monkeypatch.setattr(programmed, "FILE", tmp_path / "programs.json")
    programmed.FILE.write_text(json.dumps(found))
    with pytest.raises(ValueError, match=r"programs.json was measured on a busy machine: tour: other programs used"):
        programmed.load()


def test_figures_are_current():
    """By one seed of those that the means are made of."""
    figures = json.loads(evaluate.FIGURES.read_text())["programs"]["first"]
    asked = read_trace(programmed.TRACE)
    pair = evaluate.both(programmed.robot(), asked, read_workload(programmed.WORKLOAD), 1)
    assert evaluate.rounded(evaluate.row_of(*pair, asked)) == figures, REMEDY
