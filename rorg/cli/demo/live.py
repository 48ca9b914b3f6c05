"""The live table of the demo: all services in columns, coloured by their state, redrawn in place on a terminal."""

from __future__ import annotations

from collections.abc import Callable

from rich.columns import Columns
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from rorg.cli.demo.snapshot import Snapshot, State

PER_SECOND = 5
LOOKS: dict[State, tuple[str, str]] = {"running": ("●", "green"), "paused": ("‖", "blue"), "stopped": ("○", "dim")}
"""State -> its mark and style."""


def render(snapshot: Snapshot) -> Group:
    """Draw the services of a snapshot, and their counts."""
    cells = [
        Text(f"{LOOKS[service.state][0]} {name}", style=LOOKS[service.state][1])
        for name, service in sorted(snapshot.services.items())
    ]
    legend = Text(snapshot.counts(), style="bold")
    return Group(Text(), Columns(cells, equal=True, column_first=True, padding=(0, 2)), legend)


class LiveTable:
    """Draws the table below everything that the console prints. `look` returns the present snapshot; the table's own
    thread calls it."""

    def __init__(self, console: Console, look: Callable[[], Snapshot]) -> None:
        self._live = Live(
            console=console,
            refresh_per_second=PER_SECOND,
            transient=True,
            get_renderable=lambda: render(look()),
        )

    def start(self) -> None:
        self._live.start(refresh=True)

    def stop(self) -> None:
        """Erase the table. Does nothing a second time."""
        self._live.stop()
