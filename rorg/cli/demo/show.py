"""What the demo shows: a live table on a terminal, plain lines elsewhere, and the picture of two moments side by
side."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.sax.saxutils import escape

from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from rorg.cli.output import rich_table
from rorg.model.units import format_memory
from rorg.plots.states import LOOKS


class Show:
    """Prints and draws the demo."""

    def __init__(self, speed: float, svg: str | None) -> None:
        self.console = Console(highlight=False)
        self.speed, self.svg = speed, svg
        self.live: Live | None = None
        self.heading = ""
        self._usage: tuple[float, dict[str, Any]] = (0.0, {})
        self._rates: dict[str, float] = {}
        self._drawn = 0.0
        self._moments: list[Moment] = []

    def title(self, text: str) -> None:
        self.console.print(Text(text, style="bold"))

    def line(self, text: str) -> None:
        self.console.print(Text(text), soft_wrap=True)

    def step(self, text: str) -> None:
        """Begins a new part of the show."""
        self.heading = text
        self.console.print(Text(f"\n{text}", style="bold cyan"))

    def progress(self, text: str) -> None:
        if self.console.is_terminal:
            self.console.print(Text(f"  {text:<60}"), end="\r")

    def event(self, text: str) -> None:
        """Prints a line of the loop."""
        if not self.console.is_terminal:
            self.console.print(Text(f"  {text}"), soft_wrap=True)

    def pause(self, robot: Any, seconds: float) -> None:
        """Lets people look, and redraws the table."""
        end = time.monotonic() + seconds / self.speed
        while time.monotonic() < end:
            self.table(robot)
            time.sleep(0.05)

    def table(self, robot: Any) -> None:
        """Draws the table, at most four times a second."""
        now = time.monotonic()
        if not self.console.is_terminal or now - self._drawn < 0.25:
            return
        self._drawn = now
        if self.live is None:
            self.live = Live(console=self.console, auto_refresh=False, transient=True)
            self.live.start()
        self.live.update(self.render(robot), refresh=True)

    def render(self, robot: Any) -> Any:
        rows, idle = self.rows(robot)
        cpu = sum(r["_cpu"] for r in rows)
        memory = sum(r["_memory"] for r in rows)
        foot = Text(f"{len(rows)} active, {idle} idle; {cpu:.2f} cores, {format_memory(memory)}", style="bold")
        return Group(
            Text(self.heading, style="bold cyan"), rich_table(rows, ["service", "state", "why", "cpu", "memory"]), foot
        )

    def rows(self, robot: Any) -> tuple[list[dict[str, Any]], int]:
        """The running services, with CPU in cores since the last look and memory in bytes; and the number of idle
        ones."""
        now, usage = time.monotonic(), robot.usage()
        before_at, before = self._usage
        if now - before_at > 0.2:
            self._rates = {
                n: max(0.0, u.cpu - before[n].cpu) / (now - before_at) for n, u in usage.items() if n in before
            }
            self._usage = (now, usage)
        rows, idle = [], 0
        for name, status in robot.view()["services"].items():
            if status["state"] == "running":
                use = usage.get(name)
                rows.append(
                    {
                        "service": name,
                        "state": status["state"],
                        "why": status["why"],
                        "cpu": f"{self._rates.get(name, 0.0):.2f}",
                        "memory": format_memory(use.memory) if use else "",
                        "_cpu": self._rates.get(name, 0.0),
                        "_memory": use.memory if use else 0,
                    }
                )
            elif status["state"] != "meta":
                idle += 1
        return rows, idle

    def remember(self, title: str, robot: Any) -> None:
        """Keeps the current states for the picture."""
        states = {n: s["state"] for n, s in robot.view()["services"].items() if s["state"] != "meta"}
        self._moments.append(Moment(title, states))

    def save(self, bars: Sequence[Bar]) -> None:
        """Writes the picture, if one was asked for."""
        if self.svg:
            Path(self.svg).write_text(picture(self._moments, bars), encoding="utf-8")

    def close(self) -> None:
        if self.live:
            self.live.stop()
            self.live = None


COLUMNS, GAP, LETTER, TILE_HEIGHT = 3, 4, 6.7, 18
"""Of a panel; the others are points."""
COLOURS = {
    "running": (LOOKS["ready"].bar, "#ffffff"),
    "paused": (LOOKS["idle"].box, LOOKS["idle"].edge),
    "stopped": (LOOKS["stopped"].box, LOOKS["stopped"].edge),
}
"""Of a tile and its text."""
STYLE = """text { font: 11px ui-monospace, Menlo, Consolas, monospace }
.title { font: bold 14px system-ui, sans-serif; fill: #1f2328 }
.note { font: 12px system-ui, sans-serif; fill: #59636e }
@media (prefers-color-scheme: dark) { .title { fill: #f0f6fc } .note { fill: #9198a1 } .stopped { opacity: .45 } }"""


class Moment(NamedTuple):
    """The states of the services at one time: name -> the engine's word."""

    title: str
    states: Mapping[str, str]


class Bar(NamedTuple):
    """A figure with everything on, and on demand."""

    name: str
    everything: float
    on_demand: float
    form: str
    """The format of the figure, such as "{:.2f} cores"."""


def picture(moments: Sequence[Moment], bars: Sequence[Bar]) -> str:
    """An SVG in one file, readable on light and dark pages."""
    rows = max(-(-len(m.states) // COLUMNS) for m in moments)
    top = 64 + rows * (TILE_HEIGHT + GAP)
    tile = 12 + round(LETTER * max(len(name) for m in moments for name in m.states))
    panel = COLUMNS * (tile + GAP) + 12
    width, height = panel * len(moments) + 12, top + 12 + 46 * len(bars)
    parts = [part for i, moment in enumerate(moments) for part in _panel(moment, 12 + i * panel, tile)]
    parts += [part for i, bar in enumerate(bars) for part in _bar(bar, top + 12 + i * 46, width - 24)]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" role="img">\n'
        f"<style>{STYLE}</style>\n" + "\n".join(parts) + "\n</svg>\n"
    )


def _panel(moment: Moment, left: int, tile: int) -> list[str]:
    """The states of one moment. Each count is a tile of its state's colour: they are the legend."""
    shown = {name: state if state in COLOURS else "stopped" for name, state in sorted(moment.states.items())}
    parts = [_text(left, 22, "title", moment.title)]
    for index, state in enumerate(COLOURS):
        count = list(shown.values()).count(state)
        parts.append(_tile(left + index * (tile + GAP), 30, tile, state, f"{count} {state}"))
    for index, (name, state) in enumerate(shown.items()):
        x, y = left + index % COLUMNS * (tile + GAP), 60 + index // COLUMNS * (TILE_HEIGHT + GAP)
        parts.append(_tile(x, y, tile, state, name))
    return parts


def _tile(x: int, y: int, width: int, state: str, text: str) -> str:
    fill, ink = COLOURS[state]
    return (
        f'<g class="{state}"><rect x="{x}" y="{y}" width="{width}" height="{TILE_HEIGHT}" rx="4" fill="{fill}"/>'
        f'<text x="{x + 6}" y="{y + 13}" fill="{ink}">{escape(text)}</text></g>'
    )


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
