"""What variants cost, which of them none beats, and the picture of that."""

from __future__ import annotations

import pytest
from common import ROOT

from rorg.manifest.traces import read_trace
from rorg.model.catalog import Catalog
from rorg.tools.sim.plots import draw_runs, draw_sweep
from rorg.tools.sim.results import Response, RunResult, Sample, Violation
from rorg.tools.sim.variants import Variant, tried

GIB = 1 << 30


def run(name: str, cpu: float, gib: float, waits: list[float | None]) -> RunResult:
    responses = tuple(Response(float(i), "guide", "guide", "tour", wait) for i, wait in enumerate(waits))
    samples = (Sample(5.0, cpu, int(gib * GIB), frozenset()), Sample(10.0, cpu, int(gib * GIB), frozenset()))
    late = (Violation(1.0, "late", "arm", "too late"),) if None in waits else ()
    return RunResult(name, 10.0, samples, responses, late, {"start": 3, "stop": 2})


def variants(*settings: dict[str, str]) -> list[Variant]:
    return [Variant(",".join(f"{k}={v}" for k, v in one.items()), Catalog(), one) for one in settings]


def test_waiting_is_told_of_requests_that_have_to_wait_for_something_somewhere():
    found = tried(
        variants({"linger": "0s"}, {"linger": "1m"}),
        [run("a", 1.0, 1, [0.0, 1.0, 3.0, 2.0, 0.0]), run("b", 2.0, 1, [0.0, 0.0, 3.0, None, 0.0])],
    )
    short, long = (one.as_json() for one in found)
    assert [short[f"response_{key}"] for key in ("mean", "median", "p95")] == [2.0, 2.0, 3.0]
    assert short["requests"] == 3
    assert (long["requests"], long["response_mean"], long["unready"], long["violations"]) == (3, 1.5, 1, 1)
    assert (short["cpu"], short["memory"], short["calls"]) == (1.0, GIB, 5)


def test_a_variant_is_efficient_that_no_other_beats():
    """The third is slower than the first, and costs the same; the last costs most and waits least."""
    found = tried(
        variants(*({"linger": f"{i}s"} for i in range(4))),
        [run("", 1.0, 1, [2.0]), run("", 2.0, 0.5, [2.0]), run("", 1.0, 1, [3.0]), run("", 3.0, 2, [0.0])],
    )
    assert [one.efficient for one in found] == [True, True, False, True]


def test_two_that_cost_the_same_are_both_efficient():
    found = tried(variants({"idle": "pause"}, {"idle": "stop"}), [run("", 1.0, 1, [2.0]), run("", 1.0, 1, [2.0])])
    assert all(one.efficient for one in found)


def test_nothing_requested_is_no_waiting():
    (found,) = tried(variants({"idle": "pause"}), [run("", 1.0, 1, [])])
    assert (found.as_json()["response_mean"], found.as_json()["response_p95"]) == (0.0, 0.0)


@pytest.mark.slow
def test_the_picture_has_a_line_for_each_combination_of_the_other_settings():
    settings = [{"linger": linger, "idle": idle} for linger in ("0s", "1m") for idle in ("pause", "stop")]
    results = [run("", *figures) for figures in ((1, 2, [1.0]), (1, 1, [2.0]), (2, 2, [0.5]), (2, 3, [1.5]))]
    figure = draw_sweep(tried(variants(*settings), results), "a day", "Synthetic.")
    cpu, memory = figure.axes
    lines = {
        line.get_label(): list(zip(*line.get_data(), strict=True)) for line in cpu.lines if len(line.get_data()[0]) > 1
    }
    assert lines == {"idle=pause": [(1, 1.0), (2, 0.5)], "idle=stop": [(1, 2.0), (2, 1.5)]}
    assert [text.get_text() for text in memory.texts] == ["0s", "1m", "0s", "1m"]
    hollow = [line.get_data()[0][0] for line in memory.lines if line.get_markerfacecolor() == "white"]
    assert hollow == pytest.approx([3.0]), "the one that is beaten"
    assert "Synthetic." in figure.get_supxlabel()


def test_the_labels_of_near_points_do_not_collide():
    """Two points in one place share a label, and none is cut off by the edge of the panel."""
    lingers = ("0s", "5s", "20s", "60s")
    settings = [{"linger": linger, "idle": idle} for idle in ("pause", "stop") for linger in lingers]
    gib = (2.7, 2.7, 2.7, 2.7, 1.75, 1.76, 1.81, 1.9)
    waits = (0.22, 0.22, 0.20, 0.16, 0.31, 0.31, 0.26, 0.2)
    results = [run("", 1.8, g, [wait]) for g, wait in zip(gib, waits, strict=True)]
    figure = draw_sweep(tried(variants(*settings), results), "an hour", "Synthetic.")
    memory = figure.axes[1]
    assert [text.get_text() for text in memory.texts] == ["0s, 5s", "20s", "60s", "0s, 5s", "20s", "60s"]
    boxes = [text.get_window_extent() for text in memory.texts]
    assert not [(a, b) for i, a in enumerate(boxes) for b in boxes[:i] if a.overlaps(b)]
    assert all(memory.bbox.contains(*corner) for box in boxes for corner in box.corners())


def test_no_text_of_the_plot_meets_another():
    """Texts as long as they are, in the figure of a trace with all states; each state has a lane with its name."""
    trace = read_trace(ROOT / "docs/evaluation/day.yaml")
    figure = draw_runs([run(name, 1.0, 1, [1.0]) for name in ("all-on", "rorg")], trace, "measured on Docker " * 8)
    figure.draw_without_rendering()
    activity, legend = figure.axes[-1], figure.legends[0]
    lanes = activity.get_yticklabels()
    assert {text.get_text() for text in lanes} == {span[3] for span in trace.states()}
    labels = [axis.label for axes in figure.axes for axis in (axes.xaxis, axes.yaxis) if axis.label.get_text()]
    texts = [*lanes, *activity.get_xticklabels(), *labels, *legend.get_texts(), *figure.texts]
    boxes = [text.get_window_extent() for text in texts]
    assert not [(a, b) for i, a in enumerate(boxes) for b in boxes[:i] if a.overlaps(b)]
    assert all(figure.bbox.contains(*corner) for box in boxes for corner in box.corners())
