"""What the demo shows: a live table on a terminal, plain lines elsewhere."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from rorg.cli.demo.picture import Bar, Moment, picture
from rorg.cli.output import rich_table
from rorg.model.units import format_memory


class Show:
    """What the demo prints and draws."""

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
        """A new part of the show."""
        self.heading = text
        self.console.print(Text(f"\n{text}", style="bold cyan"))

    def progress(self, text: str) -> None:
        if self.console.is_terminal:
            self.console.print(Text(f"  {text:<60}"), end="\r")

    def event(self, text: str) -> None:
        """A line of the loop."""
        if not self.console.is_terminal:
            self.console.print(Text(f"  {text}"), soft_wrap=True)

    def pause(self, robot: Any, seconds: float) -> None:
        """Lets people look; the table goes on."""
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
        """Of the services that run, with CPU in cores since the last look and memory in bytes."""
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
        """How the services are at this moment, for the picture."""
        states = {n: s["state"] for n, s in robot.view()["services"].items() if s["state"] != "meta"}
        self._moments.append(Moment(title, states))

    def save(self, bars: Sequence[Bar]) -> None:
        """The picture, where one is asked for."""
        if self.svg:
            Path(self.svg).write_text(picture(self._moments, bars), encoding="utf-8")

    def close(self) -> None:
        if self.live:
            self.live.stop()
            self.live = None
