"""The graph of services as a figure, for PNG; drawing.py writes the same as SVG, for light and dark pages."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from rorg.plots.drawing import EDGE, HEIGHT, PAD, ROW, Drawing, label, layout
from rorg.plots.states import LOOKS
from rorg.plots.times import MACHINE, QUIET

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.path import Path

POINTS = 72
"""Of an inch."""


def draw_graph(drawing: Drawing) -> Figure:
    """The figure. Raises Invalid without pygraphviz."""
    from matplotlib.figure import Figure
    from matplotlib.patches import FancyArrowPatch

    boxes, curves, width, height = layout(drawing)
    looks = [look for look in LOOKS if look in drawing.looks.values()]
    height += ROW if looks else 0
    figure = Figure(figsize=(width / POINTS, height / POINTS))
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.set_axis_off()
    for arrow, curve in zip(drawing.arrows, curves, strict=True):
        style = "dashed" if arrow.dashed else "solid"
        axes.add_patch(
            FancyArrowPatch(path=_path(curve), arrowstyle="-|>", mutation_scale=7, ec=QUIET, fc=QUIET, ls=style)
        )
    for name, box in boxes.items():
        _box(axes, box.left, box.top, box.width, label(drawing, name), drawing.looks.get(name, ""))
    for index, look in enumerate(looks):
        _box(axes, EDGE + index * 100, height - ROW, 90, f"{LOOKS[look].sign} {look}", look)
    return figure


def _path(curve: str) -> Path:
    """A path of SVG, which begins with M, goes on with cubic curves, and ends with a line."""
    from matplotlib.path import Path

    numbers = [float(text) for text in re.findall(r"-?[\d.]+", curve)]
    points = list(zip(numbers[::2], numbers[1::2], strict=True))
    return Path(points, [Path.MOVETO, *[Path.CURVE4] * (len(points) - 2), Path.LINETO])


def _box(axes: Axes, left: float, top: float, width: float, text: str, look: str) -> None:
    from matplotlib.patches import FancyBboxPatch

    shown = LOOKS.get(look)
    fill, edge = (shown.box, shown.edge) if shown else ("#eaeef2", QUIET)
    corner = "round,pad=0,rounding_size=4"
    axes.add_patch(FancyBboxPatch((left, top), width, HEIGHT, boxstyle=corner, facecolor=fill, edgecolor=edge))
    axes.text(left + PAD, top + HEIGHT / 2, text, va="center", fontsize=7.5, color=MACHINE, family="monospace")
