"""The pictures of the demo's summary: bars as text, and an SVG of two moments side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple
from xml.sax.saxutils import escape

from rorg.cli.demo.snapshot import Snapshot, State
from rorg.plots.states import LOOKS

WIDTH = 40
"""Characters of the longest bar."""
COLUMNS, GAP, LETTER, TILE_HEIGHT = 3, 4, 6.7, 18
"""Of a panel; the others are points."""
COLOURS: Mapping[State, tuple[str, str]] = {
    "running": (LOOKS["ready"].bar, "#ffffff"),
    "paused": (LOOKS["idle"].box, LOOKS["idle"].edge),
    "stopped": (LOOKS["stopped"].box, LOOKS["stopped"].edge),
}
"""Of a tile and its text."""
STYLE = """text { font: 11px ui-monospace, Menlo, Consolas, monospace }
.title { font: bold 14px system-ui, sans-serif; fill: #1f2328 }
.note { font: 12px system-ui, sans-serif; fill: #59636e }
@media (prefers-color-scheme: dark) { .title { fill: #f0f6fc } .note { fill: #9198a1 } .stopped { opacity: .45 } }"""


class Bar(NamedTuple):
    """A figure with everything on, and on demand."""

    name: str
    everything: float
    on_demand: float
    form: Callable[[float], str]
    """Formats a figure with its unit."""

    @property
    def share(self) -> float:
        """The share of `everything` that is left on demand."""
        return self.on_demand / self.everything if self.everything else 1.0

    def lines(self) -> Iterator[str]:
        """Yield the two bars as text."""
        rest = "█" * round(WIDTH * min(1.0, self.share))
        yield f"{self.name:<7} everything on {self.form(self.everything):>10}  {'█' * WIDTH}"
        yield f"{'':<7} on demand     {self.form(self.on_demand):>10}  {rest} {self.share - 1:+.0%}"


def picture(moments: Mapping[str, Snapshot], bars: Sequence[Bar]) -> str:
    """An SVG in one file, readable on light and dark pages."""
    rows = max(-(-len(moment.services) // COLUMNS) for moment in moments.values())
    top = 64 + rows * (TILE_HEIGHT + GAP)
    tile = 12 + round(LETTER * max(len(name) for moment in moments.values() for name in moment.services))
    panel = COLUMNS * (tile + GAP) + 12
    width, height = panel * len(moments) + 12, top + 12 + 46 * len(bars)
    parts = [
        part
        for i, (title, moment) in enumerate(moments.items())
        for part in _panel(title, moment, 12 + i * panel, tile)
    ]
    parts += [part for i, bar in enumerate(bars) for part in _bar(bar, top + 12 + i * 46, width - 24)]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" role="img">\n'
        f"<style>{STYLE}</style>\n" + "\n".join(parts) + "\n</svg>\n"
    )


def _panel(title: str, moment: Snapshot, left: int, tile: int) -> list[str]:
    """The states of one moment. Each count is a tile of its state's colour: they are the legend."""
    parts = [_text(left, 22, "title", title)]
    for index, state in enumerate(COLOURS):
        parts.append(_tile(left + index * (tile + GAP), 30, tile, state, f"{len(moment.names(state))} {state}"))
    for index, (name, service) in enumerate(sorted(moment.services.items())):
        x, y = left + index % COLUMNS * (tile + GAP), 60 + index // COLUMNS * (TILE_HEIGHT + GAP)
        parts.append(_tile(x, y, tile, service.state, name))
    return parts


def _tile(x: int, y: int, width: int, state: State, text: str) -> str:
    fill, ink = COLOURS[state]
    return (
        f'<g class="{state}"><rect x="{x}" y="{y}" width="{width}" height="{TILE_HEIGHT}" rx="4" fill="{fill}"/>'
        f'<text x="{x + 6}" y="{y + 13}" fill="{ink}">{escape(text)}</text></g>'
    )


def _bar(bar: Bar, y: int, width: int) -> list[str]:
    room, left = width - 330, 12
    lines = [
        ("everything on", 1.0, bar.everything, "#cf222e"),
        ("on demand", min(1.0, bar.share), bar.on_demand, "#1a7f37"),
    ]
    parts = []
    for index, (what, part, value, colour) in enumerate(lines):
        top = y + 20 * index
        told = bar.form(value) + (f"  ({bar.share - 1:+.0%})" if index else "")
        parts += [
            _text(left, top + 12, "note", f"{bar.name if not index else ''}"),
            _text(left + 70, top + 12, "note", what),
            f'<rect x="{left + 170}" y="{top}" width="{room * part:.0f}" height="15" rx="3" fill="{colour}"/>',
            _text(left + 178 + room * part, top + 12, "note", told),
        ]
    return parts


def _text(x: float, y: float, kind: str, text: str) -> str:
    return f'<text x="{x:.0f}" y="{y}" class="{kind}">{escape(text)}</text>'
