"""The picture of the demo: two moments of the robot side by side, idle services dimmed, and what that saves as bars."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple
from xml.sax.saxutils import escape

COLUMNS, GAP = 3, 4
TILE_WIDTH, TILE_HEIGHT = 150, 18
PANEL = COLUMNS * (TILE_WIDTH + GAP) + 12
COLOURS = {"running": ("#1a7f37", "#ffffff"), "paused": ("#ddf4ff", "#0969da")}
IDLE = ("#eaeef2", "#8c959f")
STYLE = """text { font: 11px ui-monospace, Menlo, Consolas, monospace }
.title { font: bold 14px system-ui, sans-serif; fill: #1f2328 }
.note { font: 12px system-ui, sans-serif; fill: #59636e }
@media (prefers-color-scheme: dark) { .title { fill: #f0f6fc } .note { fill: #9198a1 } .idle { opacity: .35 } }"""


class Moment(NamedTuple):
    """How the services are at one time: name -> state, as the engine says."""

    title: str
    states: Mapping[str, str]


class Bar(NamedTuple):
    """A figure with everything on, and on demand."""

    name: str
    everything: float
    on_demand: float
    form: str
    """How it is written, such as "{:.2f} cores"."""


def picture(moments: Sequence[Moment], bars: Sequence[Bar]) -> str:
    """An SVG that needs nothing from elsewhere, and is readable on light and dark pages."""
    rows = max(-(-len(m.states) // COLUMNS) for m in moments)
    top = 56 + rows * (TILE_HEIGHT + GAP)
    width, height = PANEL * len(moments) + 12, top + 12 + 46 * len(bars)
    parts = [part for i, moment in enumerate(moments) for part in _panel(moment, 12 + i * PANEL)]
    parts += [part for i, bar in enumerate(bars) for part in _bar(bar, top + 12 + i * 46, width - 24)]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" role="img">\n'
        f"<style>{STYLE}</style>\n" + "\n".join(parts) + "\n</svg>\n"
    )


def _panel(moment: Moment, left: int) -> list[str]:
    counts = [list(moment.states.values()).count(state) for state in COLOURS]
    said = f"{counts[0]} run, {counts[1]} paused, {len(moment.states) - sum(counts)} stopped"
    parts = [_text(left, 22, "title", moment.title), _text(left, 42, "note", said)]
    for index, (name, state) in enumerate(sorted(moment.states.items())):
        x = left + index % COLUMNS * (TILE_WIDTH + GAP)
        y = 52 + index // COLUMNS * (TILE_HEIGHT + GAP)
        fill, ink = COLOURS.get(state, IDLE)
        kind = "" if state in COLOURS else ' class="idle"'
        parts.append(
            f'<g{kind}><rect x="{x}" y="{y}" width="{TILE_WIDTH}" height="{TILE_HEIGHT}" rx="4" fill="{fill}"/>'
            f'<text x="{x + 6}" y="{y + 13}" fill="{ink}">{escape(_short(name))}</text></g>'
        )
    return parts


def _short(name: str, most: int = 21) -> str:
    """In a picture a name may be cut; no listing does that."""
    return name if len(name) <= most else name[: most - 1] + "…"


def _bar(bar: Bar, y: int, width: int) -> list[str]:
    share = min(1.0, bar.on_demand / bar.everything) if bar.everything else 1.0
    room, left = width - 330, 12
    lines = [("everything on", 1.0, bar.everything, "#cf222e"), ("on demand", share, bar.on_demand, "#1a7f37")]
    parts = []
    for index, (what, part, value, colour) in enumerate(lines):
        top = y + 20 * index
        told = bar.form.format(value) + (f"  ({share - 1:+.0%})" if index else "")
        parts += [
            _text(left, top + 12, "note", f"{bar.name if not index else ''}"),
            _text(left + 70, top + 12, "note", what),
            f'<rect x="{left + 170}" y="{top}" width="{room * part:.0f}" height="15" rx="3" fill="{colour}"/>',
            _text(left + 178 + room * part, top + 12, "note", told),
        ]
    return parts


def _text(x: float, y: float, kind: str, text: str) -> str:
    return f'<text x="{x:.0f}" y="{y}" class="{kind}">{escape(text)}</text>'
