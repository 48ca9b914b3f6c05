"""Draws graphs as text for other programs (DOT, Mermaid) and as a picture (SVG)."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from html import escape
from typing import NamedTuple

FORMS = ("dot", "mermaid", "svg")
LETTER, HEIGHT, PAD = 6.7, 20, 8
"""Points: a character, a box, and the space left and right of its text."""
BETWEEN, BELOW, EDGE = 70, 6, 10
"""Points: between columns, between boxes in a column, and around the picture."""
STYLE = """text { font: 11px ui-monospace, Menlo, Consolas, monospace; fill: #1f2328 }
rect { fill: #eaeef2; stroke: #59636e }
.bold rect { fill: #ddf4ff; stroke-width: 2 }
.dashed rect { fill: none; stroke-dasharray: 4 3 }
path { fill: none; stroke: #8c959f }
path.dashed { stroke-dasharray: 4 3 }
@media (prefers-color-scheme: dark) {
  text { fill: #f0f6fc } rect { fill: #21262d } .bold rect { fill: #0c2d6b } path { stroke: #6e7681 }
}"""


class Arrow(NamedTuple):
    """From what needs something, or is built on it, to that."""

    begin: str
    end: str
    dashed: bool = False


class Drawing(NamedTuple):
    """A graph, and how its parts look."""

    levels: Sequence[Sequence[str]]
    """All names, each after those that its arrows lead to: the columns of a picture, from the left."""
    arrows: Sequence[Arrow]
    bold: Collection[str] = ()
    dashed: Collection[str] = ()
    """Boxes that are only named."""


def draw(drawing: Drawing, form: str) -> str:
    """The graph in one of FORMS."""
    return {"dot": dot, "mermaid": mermaid, "svg": svg}[form](drawing)


def dot(drawing: Drawing) -> str:
    """For Graphviz."""
    styles = {**dict.fromkeys(drawing.dashed, " [style=dashed]"), **dict.fromkeys(drawing.bold, " [style=bold]")}
    nodes = [f'  "{name}"{styles.get(name, "")};' for name in sorted(n for level in drawing.levels for n in level)]
    arrows = [f'  "{a.begin}" -> "{a.end}"{" [style=dashed]" if a.dashed else ""};' for a in drawing.arrows]
    return "\n".join(["digraph rorg {", "  rankdir=LR; node [shape=box];", *nodes, *arrows, "}"])


def mermaid(drawing: Drawing) -> str:
    """For Markdown pages. A name that Mermaid would refuse gets a number in front."""
    names = sorted(n for level in drawing.levels for n in level)
    plain = {n: n if re.fullmatch(r"[\w.-]+", n) else f'i{at}["{n}"]' for at, n in enumerate(names)}
    alone = set(names) - {end for a in drawing.arrows for end in (a.begin, a.end)}
    arrows = [f"  {plain[a.begin]} {'-.->' if a.dashed else '-->'} {plain[a.end]}" for a in drawing.arrows]
    return "\n".join(["graph LR", *(f"  {plain[name]}" for name in sorted(alone)), *arrows])


class Box(NamedTuple):
    """The place of a name, in points."""

    left: float
    top: float
    width: float

    @property
    def middle(self) -> float:
        return self.top + HEIGHT / 2


def svg(drawing: Drawing) -> str:
    """A picture in one file, for light and dark pages: a column for each level."""
    boxes = _boxes(drawing)
    width = EDGE + max((box.left + box.width for box in boxes.values()), default=0)
    height = EDGE + max((box.top + HEIGHT for box in boxes.values()), default=0)
    parts = [_line(boxes[a.begin], boxes[a.end], a.dashed) for a in drawing.arrows]
    for name, box in boxes.items():
        kind = "bold" if name in drawing.bold else "dashed" if name in drawing.dashed else "plain"
        parts.append(
            f'<g class="{kind}"><rect x="{box.left:g}" y="{box.top:g}" width="{box.width:g}" height="{HEIGHT}" rx="4"/>'
            f'<text x="{box.left + PAD:g}" y="{box.top + 14:g}">{escape(name)}</text></g>'
        )
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" width="{width:g}" role="img">'
    return "\n".join([head, f"<style>{STYLE}</style>", *parts, "</svg>"])


def _boxes(drawing: Drawing) -> dict[str, Box]:
    """Places names column by column, each near those that it leads to, so that few lines cross."""
    boxes: dict[str, Box] = {}
    left = float(EDGE)
    for names in drawing.levels:
        width = LETTER * max(map(len, names), default=0) + 2 * PAD
        placed = sorted((_height(name, drawing.arrows, boxes), name) for name in names)
        boxes |= {name: Box(left, EDGE + at * (HEIGHT + BELOW), width) for at, (_, name) in enumerate(placed)}
        left += width + BETWEEN
    return boxes


def _height(name: str, arrows: Sequence[Arrow], boxes: Mapping[str, Box]) -> float:
    """The average height of the names that a name leads to."""
    tops = [boxes[a.end].top for a in arrows if a.begin == name and a.end in boxes]
    return sum(tops) / len(tops) if tops else 0.0


def _line(begin: Box, end: Box, dashed: bool) -> str:
    """A curve from the left edge of one box to the right edge of the other."""
    right = end.left + end.width
    bend = max(abs(begin.left - right) / 2, BETWEEN / 2)
    kind = ' class="dashed"' if dashed else ""
    points = (begin.left, begin.middle, begin.left - bend, begin.middle, right + bend, end.middle, right, end.middle)
    return '<path{} d="M{:g} {:g} C{:g} {:g} {:g} {:g} {:g} {:g}"/>'.format(kind, *points)
