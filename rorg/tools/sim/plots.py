"""Plots runs: CPU and memory over time, with the robot's activity below, and sweeps. matplotlib is an extra of the
installation (`rorg[plots]`), and slow to load, so only this file imports it, and only to draw."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rorg.model.trace import Trace
from rorg.plots.figure import save
from rorg.plots.states import REQUEST
from rorg.plots.times import QUIET
from rorg.tools.sim.results import RunResult, Sample
from rorg.tools.sim.variants import Tried

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox


MOST_POINTS = 480
"""Points of a line. If there are more samples, means over equal times are drawn."""
COLOURS = ("#a8b0b9", "#0550ae")
"""Of everything on, and of rorg: light and dark, so that a grey print keeps them apart."""
ROW, REST = 0.2, 5.0
"""Inches: a lane of a state, and everything else."""
GIB = 1 << 30


def draw(results: Sequence[RunResult], trace: Trace, path: Path, footnote: str) -> None:
    """Plots CPU and memory over time. Raises Invalid as save() does."""
    save(lambda: draw_runs(results, trace, footnote), path)


def draw_runs(results: Sequence[RunResult], trace: Trace, footnote: str) -> Figure:
    """Returns the figure of draw()."""
    from matplotlib.figure import Figure

    lanes = _lanes(trace)
    height = ROW * (len(lanes) + 1)
    figure = Figure(figsize=(10, REST + height), layout="constrained")
    panels: Any = figure.subplots(3, 1, sharex=True, height_ratios=(2, 2, height))
    cpu, memory, activity = panels
    scale, unit = (3600.0, "hours") if trace.duration >= 7200 else (60.0, "minutes")
    for one, colour in zip(results, COLOURS, strict=False):
        samples = _thinned(one.samples)
        times = [s.at / scale for s in samples]
        cpu.plot(times, [s.cpu for s in samples], color=colour, linewidth=1.0)
        cpu.axhline(one.cpu, color=colour, linewidth=0.8, linestyle="--")
        memory.plot(times, [s.memory / GIB for s in samples], color=colour, linewidth=1.0)
        memory.axhline(one.memory / GIB, color=colour, linewidth=0.8, linestyle="--")
        said = f"{one.name}: {one.cpu:.2f} cores, {one.memory / GIB:.2f} GiB in the mean"
        cpu.plot([], [], color=colour, label=said)
    cpu.set_ylabel("CPU (cores)")
    memory.set_ylabel("memory (GiB)")
    for axes in (cpu, memory):
        axes.set_ylim(bottom=0)
        axes.grid(alpha=0.3)
    _activity(activity, lanes, scale)
    activity.set_xlabel(f"time of the trace ({unit})")
    activity.set_xlim(0, trace.duration / scale)
    figure.legend(loc="outside upper right", ncols=len(results), frameon=False)
    figure.suptitle(trace.name, x=0.01, ha="left", fontweight="bold")
    figure.supxlabel(footnote, x=0.01, ha="left", fontsize=7, color=QUIET)
    return figure


def _lanes(trace: Trace) -> dict[str, list[tuple[float, float]]]:
    """When the behaviour was in each state, in the order of their first times; with its name if there are several."""
    spans = trace.states()
    several = len({by for _, _, by, _ in spans}) > 1
    lanes = dict[str, list[tuple[float, float]]]()
    for begin, end, by, state in spans:
        lanes.setdefault(f"{by}: {state}" if several else state, []).append((begin, end))
    return lanes


def _activity(axes: Axes, lanes: Mapping[str, Sequence[tuple[float, float]]], scale: float) -> None:
    """Draws a lane for each state, named at its left: no colour needs to be looked up."""
    for row, bars in enumerate(lanes.values()):
        axes.broken_barh([(a / scale, (b - a) / scale) for a, b in bars], (row + 0.1, 0.8), facecolors=REQUEST)
    axes.set_yticks([row + 0.5 for row in range(len(lanes))], list(lanes))
    axes.set_ylim(max(len(lanes), 1), 0)
    axes.tick_params(left=False)
    axes.grid(axis="x", alpha=0.3)
    axes.spines[["top", "right", "left"]].set_visible(False)


def _thinned(samples: Sequence[Sample]) -> list[Sample]:
    """At most MOST_POINTS samples, each the mean of several."""
    every = -(-len(samples) // MOST_POINTS) or 1
    parts = [samples[i : i + every] for i in range(0, len(samples), every)]
    return [
        Sample(
            part[-1].at, sum(s.cpu for s in part) / len(part), sum(s.memory for s in part) // len(part), part[-1].active
        )
        for part in parts
    ]


AXES = (("CPU (cores, mean)", "cpu", 1.0), ("memory (GiB, mean)", "memory", 1 << 30))
"""Label, field of a Cost, and its unit."""


def draw_sweep(points: Sequence[Tried], title: str, note: str) -> Figure:
    """Plots how long requests wait over the CPU and memory that this costs. Each line goes through the values of the
    first setting, for one combination of the others. Filled points are not beaten by any other. `note`: below the
    plot."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5), layout="constrained")
    panels: Any = figure.subplots(1, len(AXES), sharey=True)
    lines = _lines(points)
    for axes, (label, field, unit) in zip(panels, AXES, strict=True):
        for name, line in lines.items():
            _draw(axes, name, line, field, unit)
        axes.set_xlabel(label)
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("response time (s, mean)")
    panels[0].set_ylim(bottom=0, top=max((one.cost.waiting for one in points), default=0.0) * 1.1 or None)
    if len(lines) > 1:
        panels[-1].legend(loc="lower left")
    figure.suptitle(title)
    figure.supxlabel(f"Filled: none of the others costs less of everything. {note}", fontsize="small")
    figure.draw_without_rendering()  # so that distances are known
    for axes, (_, field, unit) in zip(panels, AXES, strict=True):
        _label(axes, lines.values(), field, unit)
    return figure


def _lines(points: Sequence[Tried]) -> Mapping[str, list[Tried]]:
    """Points by their common settings; one that is not a combination of settings is on its own."""
    lines = dict[str, list[Tried]]()
    for one in points:
        rest = [f"{key}={value}" for key, value in list(one.variant.settings.items())[1:]]
        lines.setdefault(", ".join(rest) if one.variant.settings else one.variant.name, []).append(one)
    return lines


def _point(one: Tried, field: str, unit: float) -> tuple[float, float]:
    return getattr(one.cost, field) / unit, one.cost.waiting


def _draw(axes: Axes, name: str, line: Sequence[Tried], field: str, unit: float) -> None:
    points = [_point(one, field, unit) for one in line]
    (drawn,) = axes.plot([x for x, _ in points], [y for _, y in points], alpha=0.5, label=name)
    colour = drawn.get_color()
    for one, point in zip(line, points, strict=True):
        axes.plot(*point, "o", color=colour, markerfacecolor=colour if one.efficient else "white")


NEAR = 12
"""Pixels: points of a line that are nearer share a label."""
BESIDE = ((6, 4), (6, -4), (-6, 4), (-6, -4), (0, 9), (0, -9), (14, 14), (-14, -14))
"""Where a label may be, in points from its own."""


def _label(axes: Axes, lines: Iterable[Sequence[Tried]], field: str, unit: float) -> None:
    """Names the points of a panel by the first setting."""
    from matplotlib.transforms import Bbox

    labels = dict[tuple[float, float], list[str]]()
    taken = list[Bbox]()
    for line in lines:
        labelled = before = None
        for one in line:
            point = _point(one, field, unit)
            x, y = axes.transData.transform(point)
            if labelled is None or before is None or max(abs(x - before[0]), abs(y - before[1])) > NEAR:
                labelled = point
            before = x, y
            taken.append(Bbox.from_bounds(x - 4, y - 4, 8, 8))
            name = next(iter(one.variant.settings.values()), one.variant.name)
            labels.setdefault(labelled, []).append(name)
    legend = axes.get_legend()
    taken += [legend.get_window_extent()] if legend else []
    for point, names in labels.items():
        taken.append(_place(axes, ", ".join(names), point, taken))


def _place(axes: Axes, label: str, point: tuple[float, float], taken: Sequence[Bbox]) -> Bbox:
    """Writes a label where it meets no other label, point or edge, and returns its box. Without such a place, the last
    one has to do."""
    text = axes.annotate(label, point, BESIDE[0], textcoords="offset points", fontsize="small")
    for x, y in BESIDE:
        text.set_position((x, y))
        text.set_horizontalalignment("left" if x > 0 else "right" if x < 0 else "center")
        text.set_verticalalignment("bottom" if y > 0 else "top")
        box = text.get_window_extent()
        inside = all(axes.bbox.contains(*corner) for corner in box.corners())
        if inside and not box.count_overlaps(taken):
            break
    return box
