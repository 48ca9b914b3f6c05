"""rorg trace"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from rorg.cli.context import Context
from rorg.cli.kinds import FILE, duration, moment
from rorg.cli.options import Output, Robot, period
from rorg.cli.output import disk_errors, echo, note, print_rows
from rorg.cli.records import records_of
from rorg.errors import Invalid
from rorg.model.units import NAME, counted, format_seconds, parse_time

if TYPE_CHECKING:
    from rorg.model.trace import Trace

ACTIONS = ("generate", "record", "show")
GREETINGS, TOURS = 188 / 4, 10 / 4
"""Per hour, from the paper's count on a day of four hours."""
PARTS = 1000.0
"""Recorded times are rounded to this part of a second."""

Length = Annotated[
    float,
    typer.Option(
        "--duration", help="For generate: length of the day. Default: 4h.", parser=duration, show_default=False
    ),
]
Greetings = Annotated[
    int | None, typer.Option(help="For generate: number of visitors to greet. Default: 47 an hour.", min=0)
]
Tours = Annotated[
    int | None, typer.Option(help="For generate: how many of them get a tour. Default: 5 in 2 hours.", min=0)
]
Since = Annotated[
    str | None, typer.Option(help="For record: start, 10m (ago) or 2026-01-31T12:00:00Z. Default: 24h.", parser=moment)
]
File = Annotated[
    Path | None,
    typer.Option(
        "--file",
        help="For generate and record: the file to write. Default: standard output.",
        metavar="FILE",
        click_type=FILE,
    ),
]


def command(
    context: Robot,
    action: Annotated[Literal["generate", "record", "show"], typer.Argument(help="generate, record, or show FILE.")],
    trace: Annotated[Path | None, typer.Argument(help="For show: the file of a trace.", click_type=FILE)] = None,
    *,
    length: Length = 4 * 3600.0,
    greetings: Greetings = None,
    tours: Tours = None,
    seed: Annotated[int, typer.Option(help="For generate: random seed.", min=0)] = 1,
    since: Since = None,
    until: Annotated[str | None, typer.Option(help="For record: end. Default: now.", parser=moment)] = None,
    file: File = None,
    output: Output = "table",
) -> None:
    """Make traces of requests for `rorg simulate` and `rorg emulate`: generate a day of the tour guide, record the
    requests of this robot, or show a trace.

    Example: rorg trace record --since 24h --file yesterday.yaml
    """
    if (trace is not None) != (action == "show"):
        why = f"unexpected argument '{trace}'" if trace else "no file is named"
        raise Invalid(f"{action} a trace", why, f"`rorg trace {action}{' FILE' * (action == 'show')}`")
    if trace is not None:
        _show(trace, output)
    elif action == "record":
        _write(_recorded(*period(since, until), _name(file, "recorded"), context), file)
    else:
        _write(_generated(length, greetings, tours, seed, _name(file, "tour-guide")), file)


def _name(file: Path | None, otherwise: str) -> str:
    """The name of the file, if a manifest may have it; otherwise the default."""
    return file.stem if file and re.fullmatch(NAME, file.stem) else otherwise


def _generated(length: float, greetings: int | None, tours: int | None, seed: int, name: str) -> Trace:
    from rorg.tools.sim.generate import generate_day

    hours = length / 3600
    met = round(GREETINGS * hours) if greetings is None else greetings
    return generate_day(length, met, min(met, round(TOURS * hours)) if tours is None else tours, seed, name=name)


def _recorded(since: str, until: str, name: str, context: Context) -> Trace:
    from rorg.model.trace import Trace, TraceEvent

    with records_of(context) as records:
        recording = records.requested(since, until)
    if recording["unknown"]:
        note(f"{counted(recording['unknown'], 'request')} left out: an earlier rorg did not record what they name")
    begin = parse_time(recording["begin"])

    def after(at: str) -> float:
        return round((parse_time(at) - begin) * PARTS) / PARTS

    events = [TraceEvent(after(r["at"]), r["requester"], r["id"], tuple(r["services"])) for r in recording["requests"]]
    text = f"Recorded from {recording['begin']} to {recording['end']}."
    return Trace(name, after(recording["end"]), tuple(events), text)


def _write(trace: Trace, file: Path | None) -> None:
    from rorg.manifest.traces import trace_text

    text = trace_text(trace)
    if file is None:
        echo(text, end="")
        return
    with disk_errors(f"write {file}", "another file"):
        file.write_text(text)


def _show(file: Path, output: str) -> None:
    from rorg.manifest.traces import read_trace
    from rorg.tools.sim.report import activities

    trace = read_trace(file)
    statistics = activities(trace)
    requesters = sorted({event.requester for event in trace.events})
    if output in ("table", "wide"):
        echo(f"{trace.name}: {trace.description}" if trace.description else trace.name)
        events = counted(len(trace.events), "event")
        echo(f"{format_seconds(trace.duration)}, {events} of {', '.join(requesters) or 'nobody'}\n")
    rows: list[dict[str, Any]] = [
        {
            "name": one.name,
            "kind": one.kind,
            "by": one.by,
            "times": len(one.lengths),
            "share": f"{100 * one.total / trace.duration:.0f}%" if trace.duration else "-",
            "mean": format_seconds(one.mean),
            "min": format_seconds(min(one.lengths)),
            "max": format_seconds(max(one.lengths)),
        }
        for one in statistics
    ]
    full = {
        "name": trace.name,
        "description": trace.description,
        "duration": trace.duration,
        "events": len(trace.events),
        "requesters": requesters,
        "activities": [one.as_json() for one in statistics],
    }
    print_rows(rows, output, ("name", "kind", "by", "times", "share", "mean", "min", "max"), full=full)
