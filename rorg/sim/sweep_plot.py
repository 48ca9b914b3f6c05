"""A sweep as a picture: how long requests wait, over the CPU and the memory that this costs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from rorg.sim.tradeoff import Tried

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

AXES = (("CPU (cores, mean)", "cpu", 1.0), ("memory (GiB, mean)", "memory", 1 << 30))
"""Label, field of a Cost, and its unit."""


def draw_sweep(found: Sequence[Tried], title: str, note: str) -> Figure:
    """A line for each combination of all settings but the first, whose values it goes through. What none of the others
    beats is filled. `note` stands below: where the figures come from."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 5), layout="constrained")
    panels: Any = figure.subplots(1, len(AXES), sharey=True)
    for axes, (label, field, unit) in zip(panels, AXES, strict=True):
        for name, line in _lines(found).items():
            _draw(axes, name, line, field, unit)
        axes.set_xlabel(label)
        axes.grid(alpha=0.3)
    panels[0].set_ylabel("response time (s, mean)")
    panels[0].set_ylim(bottom=0)
    if len(_lines(found)) > 1:
        panels[-1].legend()
    figure.suptitle(title)
    figure.supxlabel(f"Filled: none of the others costs less of everything. {note}", fontsize="small")
    return figure


def _lines(found: Sequence[Tried]) -> Mapping[str, list[Tried]]:
    """By what they have in common; what is no combination of settings is a point by itself."""
    lines = dict[str, list[Tried]]()
    for one in found:
        rest = [f"{key}={value}" for key, value in list(one.variant.settings.items())[1:]]
        lines.setdefault(", ".join(rest) if one.variant.settings else one.variant.name, []).append(one)
    return lines


def _draw(axes: Axes, name: str, line: Sequence[Tried], field: str, unit: float) -> None:
    points = [(getattr(one.cost, field) / unit, one.cost.waiting) for one in line]
    (drawn,) = axes.plot([x for x, _ in points], [y for _, y in points], alpha=0.5, label=name)
    colour = drawn.get_color()
    for one, point in zip(line, points, strict=True):
        fill = colour if one.efficient else "white"
        axes.plot(*point, "o", color=colour, markerfacecolor=fill)
        first = next(iter(one.variant.settings.items()), ("", one.variant.name))
        axes.annotate(first[1], point, textcoords="offset points", xytext=(5, 5), fontsize="small")
