"""Prints the demo: scenes with the commands that begin them and what came of it, and a live table on a terminal."""

from __future__ import annotations

import re
import textwrap
import time
from collections.abc import Callable

from rich.console import Console
from rich.text import Text

from rorg.cli.demo.live import LiveTable
from rorg.cli.demo.snapshot import Snapshot
from rorg.cli.terminal import printable

WIDTH = 80
"""Columns after which prose is broken. A terminal would break it anywhere."""


HARD = "\u00a0"
"""A space at which no line is broken."""


class Show:
    """Prints to the console. `speed` divides the time for which people look; `verbose` prints every action of rorg;
    `svg` is the file for a picture."""

    def __init__(self, speed: float, verbose: bool, svg: str | None = None, console: Console | None = None) -> None:
        self.console = console or Console(highlight=False)
        self.speed, self.verbose, self.svg = speed, verbose, svg
        self._table: LiveTable | None = None

    def title(self, text: str) -> None:
        self._prose(text, "bold")

    def scene(self, text: str) -> None:
        """Begin a new scene."""
        self._print("")
        self._prose(text, "bold cyan")

    def command(self, line: str) -> None:
        """Print what a person or a program types."""
        self._print(f"$ {line}", "bold")

    def line(self, text: str) -> None:
        """Print what came of it."""
        self._prose(f"  {text}")

    def copied(self, text: str) -> None:
        """Print a command that people copy, on one line however long it is."""
        self._print(f"  {text}")

    def action(self, text: str) -> None:
        """Print a line of rorg's own, if every action was asked for."""
        if self.verbose:
            self._print(f"| {text}", "dim")

    def progress(self, text: str) -> None:
        """Show what takes long; the next line replaces it on a terminal."""
        if self.console.is_terminal:
            self.console.print(Text(f"  {printable(text):<60}"), end="\r")

    def look(self, seconds: float) -> None:
        """Let people look at the table."""
        time.sleep(seconds / self.speed)

    def open(self, look: Callable[[], Snapshot]) -> None:
        """Begin to draw the live table, if there is a terminal that can redraw."""
        if self.console.is_terminal and not self.console.is_dumb_terminal:
            self._table = LiveTable(self.console, look)
            self._table.start()

    def close(self) -> None:
        """Erase the live table."""
        if self._table:
            self._table.stop()
            self._table = None

    def _prose(self, text: str, style: str = "") -> None:
        """Print text in lines of WIDTH. A command in backquotes stays whole."""
        whole = re.sub("`[^`]*`", lambda quoted: quoted[0].replace(" ", HARD), text)
        indent = "    " if text.startswith("  ") else "  "
        for line in textwrap.wrap(
            whole, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
        ):
            self._print(line.replace(HARD, " "), style)

    def _print(self, text: str, style: str = "") -> None:
        self.console.print(Text(printable(text), style=style), soft_wrap=True)
