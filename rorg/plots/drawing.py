"""Draws graphs as text for other programs (DOT, Mermaid) and as a picture (SVG).

Graphviz places boxes and arrows of the picture (pygraphviz brings it along), so that they do not overlap. We write the
SVG ourselves: Graphviz's own follows neither the reader's fonts nor dark pages, and warns about fonts of this machine.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from html import escape
from importlib.util import find_spec
from typing import Any, NamedTuple

from rorg.errors import Invalid
from rorg.plots.figure import install
from rorg.plots.states import LOOKS

FORMS = ("dot", "mermaid", "svg")
LETTER, HEIGHT, PAD = 6.7, 20, 8
"""Points: a character, a box, and the space left and right of its text."""
BETWEEN, BELOW, EDGE, ROW = 50, 6, 10, 26
"""Points: between columns, between boxes in a column, around the picture, and a row of the legend."""
STYLE = """text { font: 11px ui-monospace, Menlo, Consolas, monospace; fill: #1f2328 }
rect { fill: #eaeef2; stroke: #59636e }
.bold rect { fill: #ddf4ff; stroke-width: 2 }
.dashed rect { fill: none; stroke-dasharray: 4 3 }
path { fill: none; stroke: #8c959f }
path.dashed { stroke-dasharray: 4 3 }
marker path { fill: #8c959f; stroke: none }
@media (prefers-color-scheme: dark) {
  text { fill: #f0f6fc } rect { fill: #21262d } .bold rect { fill: #0c2d6b }
  path { stroke: #6e7681 } marker path { fill: #6e7681 }
}"""
HEAD = (
    '<defs><marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
    '<path d="M0 0L8 4L0 8z"/></marker></defs>'
)
"""Of an arrow."""


class Arrow(NamedTuple):
    """From what needs something, or is built on it, to that."""

    begin: str
    end: str
    dashed: bool = False


class Drawing(NamedTuple):
    """A graph, and how its parts look."""

    names: Collection[str]
    arrows: Sequence[Arrow]
    bold: Collection[str] = ()
    dashed: Collection[str] = ()
    """Boxes that are only named."""
    legend: Mapping[str, str] = {}
    """`plain`, `bold` and `dashed` (boxes), one of LOOKS, `arrow` and `dashed arrow` -> what it means; `` -> a note."""
    looks: Mapping[str, str] = {}
    """Services, and how they are now: one of LOOKS."""


def draw(drawing: Drawing, form: str) -> str:
    """The graph in one of FORMS."""
    return {"dot": dot, "mermaid": mermaid, "svg": svg}[form](drawing)


def dot(drawing: Drawing) -> str:
    """For Graphviz."""
    styles = {**dict.fromkeys(drawing.dashed, " [style=dashed]"), **dict.fromkeys(drawing.bold, " [style=bold]")}
    nodes = [f'  "{name}"{styles.get(name, "")};' for name in sorted(drawing.names)]
    arrows = [f'  "{a.begin}" -> "{a.end}"{" [style=dashed]" if a.dashed else ""};' for a in drawing.arrows]
    return "\n".join(["digraph rorg {", "  rankdir=LR; node [shape=box];", *nodes, *arrows, "}"])


def mermaid(drawing: Drawing) -> str:
    """For Markdown pages. A name that Mermaid would refuse gets a number in front."""
    names = sorted(drawing.names)
    plain = {n: n if re.fullmatch(r"[\w.-]+", n) else f'i{at}["{n}"]' for at, n in enumerate(names)}
    alone = set(names) - {end for a in drawing.arrows for end in (a.begin, a.end)}
    arrows = [f"  {plain[a.begin]} {'-.->' if a.dashed else '-->'} {plain[a.end]}" for a in drawing.arrows]
    return "\n".join(["graph LR", *(f"  {plain[name]}" for name in sorted(alone)), *arrows])


class Box(NamedTuple):
    """The place of a name, in points."""

    left: float
    top: float
    width: float


def svg(drawing: Drawing) -> str:
    """A picture in one file, for light and dark pages. Raises Invalid without pygraphviz."""
    boxes, curves, width, height = layout(drawing)
    parts = [_path(curve, a.dashed) for a, curve in zip(drawing.arrows, curves, strict=True)]
    parts += [_box(box, label(drawing, name), _kind(drawing, name)) for name, box in boxes.items()]
    legend = _legend(drawing, height)
    width = max(width, *(EDGE + 60 + LETTER * len(text) for text in drawing.legend.values()), 0)
    height += ROW * len(drawing.legend) + EDGE
    size = f'viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img">'
    style = "\n".join([STYLE, *(_style_of(look) for look in LOOKS if look in drawing.looks.values())])
    return "\n".join([head, f"<style>{style}</style>", HEAD, *parts, *legend, "</svg>"])


def label(drawing: Drawing, name: str) -> str:
    """Return the text of a box."""
    look = drawing.looks.get(name)
    return f"{LOOKS[look].sign} {name}" if look else name


def _kind(drawing: Drawing, name: str) -> str:
    kind = "bold" if name in drawing.bold else "dashed" if name in drawing.dashed else "plain"
    return drawing.looks.get(name) or kind


def _style_of(look: str) -> str:
    """Its boxes are light on dark pages too."""
    shown = LOOKS[look]
    return (
        f".{look} rect {{ fill: {shown.box}; stroke: {shown.edge}; stroke-width: 2 }} .{look} text {{ fill: #1f2328 }}"
    )


def layout(drawing: Drawing) -> tuple[dict[str, Box], list[str], float, float]:
    """The boxes, the curve of each arrow as in the `d` of a path, and the size of it all, by Graphviz. Its labels are
    empty: only they need fonts."""
    graph = _placed(drawing)
    right, top = map(float, graph.graph_attr["bb"].split(",")[2:])
    boxes = {}
    for name in sorted(drawing.names):
        attributes = graph.get_node(name).attr
        (x, y), width = map(float, attributes["pos"].split(",")), 72 * float(attributes["width"])
        boxes[name] = Box(EDGE + x - width / 2, EDGE + top - y - HEIGHT / 2, width)
    curves = [
        _curve(graph.get_edge(arrow.begin, arrow.end, key=str(number)).attr["pos"], top)
        for number, arrow in enumerate(drawing.arrows)
    ]
    return boxes, curves, right + 2 * EDGE, top + 2 * EDGE


def _placed(drawing: Drawing) -> Any:
    """The graph of pygraphviz with its layout. Raises Invalid if pygraphviz is missing, or does not work: its wheel
    needs libraries of the machine, which a bare Debian does not have."""
    if find_spec("pygraphviz") is None:
        raise Invalid("draw a picture", "pygraphviz is not installed", f"{install()}, or -o mermaid")
    try:
        import pygraphviz

        graph = pygraphviz.AGraph(
            directed=True,
            strict=False,
            rankdir="LR",
            nodesep=BELOW / 72,
            ranksep=BETWEEN / 72,
            outputorder="nodesfirst",
        )
        for name in sorted(drawing.names):
            width = LETTER * len(label(drawing, name)) + 2 * PAD
            graph.add_node(name, label="", shape="box", fixedsize=True, width=width / 72, height=HEIGHT / 72)
        for number, arrow in enumerate(drawing.arrows):
            graph.add_edge(arrow.begin, arrow.end, key=str(number))
        graph.layout("dot")
    except (ImportError, OSError, ValueError) as error:
        why = f"pygraphviz does not work here: {' '.join(str(error).split())}"
        remedy = "`apt install graphviz`, which brings the libraries that it needs, or -o mermaid"
        raise Invalid("draw a picture", why, remedy) from None
    return graph


def _curve(spline: str, top: float) -> str:
    """A spline as Graphviz writes it, `e,X,Y X,Y ...` with the tip first and y upwards, for a path of SVG."""
    points = [tuple(map(float, text.removeprefix("e,").split(","))) for text in spline.replace("\\\n", "").split()]
    tip, begin, *bends = (f"{EDGE + x:.1f} {EDGE + top - y:.1f}" for x, y in points)
    return f"M{begin}C{' '.join(bends)}L{tip}"


def _path(curve: str, dashed: bool) -> str:
    return f'<path{" class=" + chr(34) + "dashed" + chr(34) if dashed else ""} d="{curve}" marker-end="url(#head)"/>'


def _box(box: Box, name: str, kind: str) -> str:
    left, top, width = box
    return (
        f'<g class="{kind}"><rect x="{left:.1f}" y="{top:.1f}" width="{width:.1f}" height="{HEIGHT}" rx="4"/>'
        f'<text x="{left + PAD:.1f}" y="{top + 14:.1f}">{escape(name)}</text></g>'
    )


def _legend(drawing: Drawing, top: float) -> list[str]:
    """A row for each meaning, below the picture."""
    parts = []
    for row, (kind, text) in enumerate(drawing.legend.items()):
        at = top + ROW * row
        if "arrow" in kind:
            parts.append(_path(f"M{EDGE} {at + HEIGHT / 2}L{EDGE + 40} {at + HEIGHT / 2}", kind.startswith("dashed")))
        elif kind:
            parts.append(_box(Box(EDGE, at, 40), "name", kind))
        parts.append(f'<text class="legend" x="{EDGE + 50}" y="{at + 14:.1f}">{escape(text)}</text>')
    return parts
