"""docs/evaluation is what the simulator says now: by its figures, not by pixels."""

from __future__ import annotations

import json
import time

import emulated
import evaluate
import pytest
import weights

FOUND = json.loads(evaluate.FIGURES.read_text())
REMEDY = "try `make evaluation`"


def test_the_weights_follow_from_the_rule():
    assert weights.FILE.read_text() == weights.text(), "try `python docs/evaluation/weights.py`"


def test_the_weights_add_up_to_what_the_paper_says_of_the_whole_robot():
    declared = evaluate.declared(evaluate.robot())
    assert declared["cores"] == pytest.approx(0.894 * 4, abs=0.01)
    assert declared["gb"] == pytest.approx(3.41, rel=0.005)


@pytest.mark.parametrize("path", evaluate.PAGES, ids=lambda path: path.name)
def test_a_page_shows_the_figures(path):
    assert evaluate.page(path, FOUND) == path.read_text(), REMEDY


@pytest.mark.slow
@pytest.mark.parametrize("name", evaluate.TRACES)
def test_figures_and_plots_are_current(name):
    """By one seed: it is one of those that the means are made of, and that of the plot."""
    robot, trace, workload = evaluate.robot(), evaluate.trace(name), evaluate.weights()
    began = time.process_time()
    base, rorg = evaluate.both(robot, trace, workload, 1)
    assert time.process_time() - began < 20, "four times what the day may take"
    found = evaluate.row_of(base, rorg, trace)
    wrong = {k: v for k, v in found.items() if round(v, 4) != FOUND[name]["first"][k]}
    assert not wrong, REMEDY
    plot = (evaluate.HERE / f"{name}.svg").read_text()
    for run in (base, rorg):
        assert f"{run.name}: {run.cpu:.2f} cores, {run.memory / 2**30:.2f} GiB in the mean" in plot, REMEDY
    assert "synthetic weights and trace" in plot


@pytest.mark.slow
def test_a_figure_of_the_sensitivity_is_current():
    robot, trace, workload = evaluate.robot(), evaluate.trace("hour"), evaluate.weights()
    changed = evaluate.reweighted(robot, workload, dict.fromkeys(evaluate.CLASSES["perception"].services, (2.0, 2.0)))
    found = evaluate.reductions(*evaluate.both(robot, trace, changed, 1), trace)
    assert evaluate.rounded(found) == FOUND["sensitivity"]["classes"]["perception x 2"], REMEDY


def test_what_was_emulated_is_what_its_page_and_plot_show():
    """Nothing is measured anew: figures follow from the runs in the file."""
    runs = emulated.MEASURED["runs"]
    for what, told in emulated.MEASURED["reductions"].items():
        saved = [1 - rorg[what] / base[what] for base, rorg in zip(runs[::2], runs[1::2], strict=True)]
        assert told["mean"] == pytest.approx(sum(saved) / len(saved), abs=2e-4)
        assert (told["least"], told["most"]) == pytest.approx((min(saved), max(saved)), abs=2e-4)
    assert [run["name"] for run in runs] == ["all-on", "rorg"] * 3
    assert all(one["services"] >= 0.99 for run in runs for one in run["agreement"].values())
    plot = (evaluate.HERE / "emulation.svg").read_text()
    for run in emulated.first_pair():
        assert f"{run.name}: {run.cpu:.2f} cores" in plot, REMEDY
    assert "synthetic weights and trace" in plot
