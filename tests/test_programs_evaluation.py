"""The robot of real programs in docs/evaluation: its tree, and what follows from its measurements. Only `make programs`
measures."""

from __future__ import annotations

import sys

from conftest import ROOT

sys.path.insert(0, str(ROOT / "docs/evaluation"))
import programmed

from rorg.manifest.traces import trace_text

REMEDY = "try `make evaluation`"


def test_each_program_is_requested_by_some_state_or_always():
    robot = programmed.robot()
    (standing,) = robot.requests
    asked = {*standing.services, *(name for names in programmed.STATES.values() for name in names)}
    assert asked == set(programmed.programs())


def test_the_trace_is_current():
    assert programmed.TRACE.read_text() == trace_text(programmed.hour()), REMEDY


def test_what_was_not_measured_has_no_table(tmp_path, monkeypatch):
    monkeypatch.setattr(programmed, "FILE", tmp_path / "programs.json")
    assert programmed.programs_table({}) == programmed.saved_table({}) == programmed.NOT_YET
    assert programmed.headline_rows({}) == []
