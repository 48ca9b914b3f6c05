"""rorg plot"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rorg.cli.kinds import FILE, service_name
from rorg.cli.names import complete_services
from rorg.cli.options import Robot, Since, Until, period
from rorg.cli.output import missing, note
from rorg.cli.records import Kept, Served, records_of
from rorg.errors import Missing
from rorg.model.units import counted, parse_time

if TYPE_CHECKING:
    from rorg.cli.context import Context
    from rorg.plots.timeline import Story

KINDS = ("usage", "timeline", "graph")
MOST = 60
"""Lanes in one picture."""

File = Annotated[
    Path | None,
    typer.Option(
        "-o",
        "--output",
        help="The picture: a name that ends in .svg, .png or .html. Default: the first word with .svg.",
        metavar="FILE",
        click_type=FILE,
    ),
]


def command(
    context: Robot,
    what: Annotated[str, typer.Argument(help="usage, timeline or graph.", autocompletion=lambda: list(KINDS))],
    services: Annotated[
        list[str] | None,
        typer.Argument(
            help="Only these services. Default: all that ran.", parser=service_name, autocompletion=complete_services
        ),
    ] = None,
    *,
    since: Since = None,
    until: Until = None,
    file: File = None,
) -> None:
    """Draw a picture of the robot for a report: what it used, what happened, or who needs whom now.

    usage: CPU and memory of the machine and of the services that used most. timeline: the requests, the states of each
    service, and what the machine used. graph: services and their needs, with their states. Needs rorg[plots].

    Example: rorg plot timeline --since 2h -o evening.png
    """
    from rorg.plots.figure import check_drawing

    if what not in KINDS:
        raise missing("picture", what, KINDS)
    path = file or Path(f"{what}.svg")
    check_drawing(path)
    if what == "graph":
        _graph(context, services or (), path)
    else:
        draw = _usage if what == "usage" else _timeline
        draw(context, services or (), *period(since, until), path)
    note(f"wrote {path}")


def _usage(context: Context, names: Sequence[str], begin: str, end: str, path: Path) -> None:
    from rorg.plots.figure import save
    from rorg.plots.usage import draw_usage

    with records_of(context) as records:
        used = _used(records, names, begin, end)
    save(lambda: draw_usage(used, _title(context), parse_time(begin), parse_time(end)), path)


def _timeline(context: Context, names: Sequence[str], begin: str, end: str, path: Path) -> None:
    from rorg.plots.figure import save
    from rorg.plots.timeline import draw_timeline

    with records_of(context) as records:
        story = _story(context, records, names, begin, end)
    save(lambda: draw_timeline(story, _title(context)), path)


def _title(context: Context) -> str:
    return context.last_text("tree", "robot") or "rorg"


def _used(records: Served | Kept, names: Sequence[str], begin: str, end: str) -> dict[str, Any]:
    from rorg.plots.times import uses

    used = uses(records.slots(begin, end))
    for name in names:
        if name not in used:
            raise Missing(f"draw what {name} used", "nothing is on record of it in this time", "a longer `--since`")
    if not used:
        raise Missing("draw the usage", "nothing of that time is on record", "`rorg run`, and wait two minutes")
    return {name: use for name, use in used.items() if not name or not names or name in names}


def _story(context: Context, records: Served | Kept, names: Sequence[str], begin: str, end: str) -> Story:
    """What happened, with the services that ran; or with these."""
    from rorg.plots.timeline import Story, bars_of_requests, bars_of_spans
    from rorg.plots.times import uses

    until = parse_time(end)
    lanes = {name: bars_of_spans(records.timeline(name, begin, end)["spans"], until) for name in names or _all(context)}
    ran = {name: bars for name, bars in lanes.items() if name in names or any(bar.look != "stopped" for bar in bars)}
    if not any(ran.values()):
        raise Missing("draw the timeline", "nothing ran in that time", "a longer `--since`")
    if len(ran) > MOST:
        note(f"{MOST} of {counted(len(ran), 'service')} are drawn; name others, as in `rorg plot timeline NAME`")
    try:
        requests = bars_of_requests(records.requested(begin, end)["requests"], until)
    except Missing:
        requests = {}
    shown = {name: ran[name] for name in list(ran)[:MOST]}
    return Story(parse_time(begin), until, requests, shown, uses(records.slots(begin, end)).get(""))


def _all(context: Context) -> list[str]:
    from rorg.api.views import graph

    return list(context.asked("/v1/graph", lambda: graph(context.catalog()))["services"])


def _graph(context: Context, names: Sequence[str], path: Path) -> None:
    from rorg.plots.drawing import Arrow, Drawing, draw
    from rorg.plots.figure import save, write
    from rorg.plots.graph import draw_graph
    from rorg.plots.states import LOOKS, look_of

    client = context.serving("show the states of its services")
    view = client.call("GET", "/v1/graph")
    looks = {s["service"]: look for s in client.call("GET", "/v1/services") if (look := look_of(s))}
    for name in names:
        if name not in view["services"]:
            raise missing("service", name, view["services"])
    edges = [e for e in view["edges"] if e["kind"] != "uses"]
    shown = _around(names, edges) if names else set(view["services"])
    arrows = [Arrow(e["from"], e["to"], e["kind"] == "requests") for e in edges if {e["from"], e["to"]} <= shown]
    looks = {name: look for name, look in looks.items() if name in shown}
    legend = {look: look for look in LOOKS if look in looks.values()}
    legend |= {"arrow": "needs", "dashed arrow": "requests"}
    drawing = Drawing(sorted(shown), sorted(arrows), looks=looks, legend=legend)
    if path.suffix == ".png":
        save(lambda: draw_graph(drawing), path)
    else:
        write(draw(drawing, "svg").encode(), path)


def _around(names: Sequence[str], edges: Sequence[dict[str, str]]) -> set[str]:
    """These services, everything that they lead to, and everything that leads to them."""
    found = set(names)
    for begin, end in (("from", "to"), ("to", "from")):
        reached, pending = set(names), list(names)
        while pending:
            one = pending.pop()
            nearby = {edge[end] for edge in edges if edge[begin] == one} - reached
            reached |= nearby
            pending += nearby
        found |= reached
    return found
