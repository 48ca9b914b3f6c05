"""docs/evaluation/prewarm.md is what the simulator says now: by its figures."""

from __future__ import annotations

import json

import prewarm

from rorg.manifest.traces import read_trace

FOUND = json.loads(prewarm.FIGURES.read_text())
REMEDY = "try `make evaluation`"


def test_the_page_shows_the_figures():
    page = prewarm.PAGE.read_text()
    assert prewarm.written(page, FOUND) == page, REMEDY


def test_the_figures_of_the_hour_are_current():
    hour = read_trace(prewarm.HERE / "hour.yaml")
    known = {row["prewarm"]: row["hour"] for row in FOUND}
    for row in prewarm.evaluate({"hour": [hour]}, ("off", "0.05")):
        assert row["hour"] == known[row["prewarm"]], REMEDY
