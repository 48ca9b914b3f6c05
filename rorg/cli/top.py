"""rorg top"""

from __future__ import annotations

import os
import sys
import time
from typing import Annotated

import typer

from rorg.cli.context import Context
from rorg.cli.kinds import Seconds, durations
from rorg.cli.options import Output, Robot
from rorg.cli.output import print_rows, table
from rorg.cli.top_view import COLUMNS, cells_of, header, look


def command(
    context: Robot,
    once: Annotated[bool, typer.Option("--once", help="Print one table and exit.")] = False,
    interval: Annotated[float, typer.Option(help="Time between updates: 500ms, 2s.", parser=durations(0.2))] = Seconds(
        1
    ),
    output: Output = "table",
) -> None:
    """Show what runs, what it uses and who asked for it, and the machine with its pressure and budget. On a
    terminal, keys sort, filter, show logs, request, release and restart; ? lists them, q quits.

    Example: rorg top --interval 2s
    """
    screen = sys.stdout.isatty() and sys.stdin.isatty() and os.environ.get("TERM", "dumb") != "dumb"
    if once or output != "table" or not screen:
        _print(context, output, min(interval, 0.5))
    else:
        from rorg.cli.top_screen import Screen

        Screen(context, interval).run()


def _print(context: Context, output: str, seconds: float) -> None:
    """Prints one look, in any form."""
    client = context.serving("look at what runs")
    before = client.usage()
    time.sleep(seconds)
    snapshot = look(before, client.usage(), client.status())
    snapshot["services"] = [row for row in snapshot["services"] if row["alive"]]
    rows = [cells_of(row) for row in snapshot["services"]]
    text = "\n".join([table(rows, COLUMNS), *header(snapshot)])
    print_rows(rows, output, COLUMNS, full=snapshot, text=text)
