"""rorg timeline"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

import typer

from rorg.cli.kinds import service_name
from rorg.cli.names import complete_services
from rorg.cli.options import Output, Robot, Since, Until, period
from rorg.cli.output import echo, print_rows
from rorg.cli.records import records_of
from rorg.cli.terminal import printable
from rorg.errors import Missing
from rorg.model.units import format_seconds, parse_time

STATES = ("ready", "running", "restarting", "paused", "created", "exited", "removing", "dead", "none")
"""From the top of the chart down."""
LEAST = 20
"""Characters of a bar."""


def command(
    context: Robot,
    service: Annotated[
        str,
        typer.Argument(
            help="A service, also one that no longer exists.", parser=service_name, autocompletion=complete_services
        ),
    ],
    since: Since = None,
    until: Until = None,
    tail: Annotated[
        int, typer.Option("-n", "--tail", help="How many of the last states to list below the chart.", min=0)
    ] = 20,
    output: Output = "table",
) -> None:
    """Show the states of a service over time, why each began, and who asked for it: a chart, and the last states.

    Example: rorg timeline navigation --since 1h
    """
    begin, end = period(since, until)
    with records_of(context) as records:
        timeline = records.timeline(service, begin, end)
    if not timeline["spans"]:
        raise Missing(f"show what {service} went through", "nothing is on record of it", "`rorg get` for all names")
    if output in ("table", "wide"):
        echo("\n".join(chart(timeline["end"], timeline["spans"], _width())) + "\n")
    rows = [
        {
            "from": _time(span["begin"]),
            "to": _time(span["end"]) if span["end"] else "now",
            "for": _length(span["seconds"]),
            "state": span["state"],
            "why": span["why"] or "-",
            "who": span["who"] or "-",
        }
        for span in (timeline["spans"][-tail:] if tail else [])
    ]
    print_rows(rows, output, ("from", "for", "state", "why", "who"), ("to",), full=timeline, below=("why",))


def chart(end: str, spans: Sequence[dict[str, Any]], width: int) -> list[str]:
    """A bar for each state. A column stands for a part of the time, and is filled if the service was in that state at
    any moment of it; the share of the whole time is at the end. The chart begins with the first recorded state."""
    begin = spans[0]["begin"]
    first, last = parse_time(begin), parse_time(end)
    names = [s for s in STATES if any(span["state"] == s for span in spans)]
    names += sorted({span["state"] for span in spans} - set(names))
    label = max(map(len, names))
    columns = max(LEAST, width - label - 8)
    part = max((last - first) / columns, 1e-6)
    bars = {name: bytearray(b" " * columns) for name in names}
    shares = dict.fromkeys(names, 0.0)
    for span in spans:
        at = parse_time(span["begin"]) - first
        left = min(columns - 1, max(0, int(at / part)))
        right = min(columns, max(left + 1, -int(-(at + span["seconds"]) // part)))
        bars[span["state"]][left:right] = b"#" * (right - left)
        shares[span["state"]] += span["seconds"]
    whole = max(sum(shares.values()), 1e-6)
    lines = [f"{printable(n):<{label}} |{bars[n].decode()}| {100 * shares[n] / whole:3.0f}%" for n in names]
    from_, to = _time(begin), _time(end)
    between = max(1, columns - len(from_) - len(to))
    return [*lines, f"{'':<{label}}  {from_}{'':<{between}}{to}"]


def _time(at: str) -> str:
    return printable(at[:19].replace("T", " "))


def _length(seconds: float) -> str:
    return format_seconds(seconds)


def _width() -> int:
    import shutil

    return min(160, shutil.get_terminal_size((80, 24)).columns)
