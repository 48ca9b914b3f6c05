"""rorg events"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

import typer

from rorg.cli.context import Context
from rorg.cli.kinds import event_kinds, moment, service_name, words
from rorg.cli.names import complete_event_kinds, complete_services
from rorg.cli.options import Output, Robot
from rorg.cli.output import as_json, echo, end_with_reader
from rorg.cli.terminal import entry, printable
from rorg.errors import Invalid

LAST = 20
"""Entries that are shown by default."""
MOST = 1 << 40
"""More than all of them."""
MOST_TOLD = 10_000
"""The largest `tail` of the API."""

Services = Annotated[
    list[str] | None,
    typer.Argument(
        help="Only about these services. Default: about everything.",
        parser=service_name,
        autocompletion=complete_services,
    ),
]
Tail = Annotated[
    int | None, typer.Option(help="Number of entries, the last ones. Default: 20, or all with --since.", min=0)
]
Kind = Annotated[
    str,
    typer.Option(
        help="Only these kinds: crashed,failed (-o wide shows them).",
        metavar="KINDS",
        parser=event_kinds,
        autocompletion=complete_event_kinds,
    ),
]


def command(
    context: Robot,
    services: Services = None,
    *,
    follow: Annotated[bool, typer.Option("-f", "--follow", help="Follow new entries.")] = False,
    tail: Tail = None,
    kind: Kind = "",
    service: Annotated[
        str, typer.Option(help="Only about these services.", metavar="SERVICES", autocompletion=complete_services)
    ] = "",
    since: Annotated[
        str | None, typer.Option(help="Only since 10m (ago), or 2026-01-31T12:00:00Z.", parser=moment)
    ] = None,
    until: Annotated[
        str | None, typer.Option(help="Only until this time, in the form of --since.", parser=moment)
    ] = None,
    grep: Annotated[str, typer.Option(help="Only with this text in the message; case does not matter.")] = "",
    no_fold: Annotated[bool, typer.Option("--no-fold", help="Show every repeated event.")] = False,
    output: Output = "table",
) -> None:
    """Show what happened: actions and their outcomes, states of services, requests with their authors, refusals,
    crashes, pressure. Repeated events share one line ("x 14 since ..."), except with -f. JSON is one object per
    line, YAML one document per event.

    Example: rorg events navigation --kind crashed,stalled --since 1h
    """
    if follow and until:
        raise Invalid("follow events", "--until and -f contradict each other", "one of them")
    about = [*(services or ()), *words(service)]
    only = {"kind": words(kind), "service": about, "since": since or "", "until": until or "", "text": grep}
    last = tail if tail is not None else MOST if since else LAST
    events = _events(context, follow, last, only)
    if follow:
        end_with_reader()
    fold = output in ("table", "wide") and not (follow or no_fold)
    for text in _folded(events, output) if fold else (_text(event, output) for event in events):
        echo(text)


def _events(context: Context, follow: bool, last: int, only: dict[str, Any]) -> Iterator[Any]:
    """The events of the running rorg, or of its file if none runs."""
    needed = follow or not context.state.readable
    client = context.serving("follow events" if follow else "read events") if needed else context.client()
    if client:
        return client.events(follow=follow, tail=0 if last == MOST else min(last, MOST_TOLD), only=only)
    return iter(_kept(context, last, only))


def _folded(events: Iterator[Any], output: str) -> Iterator[str]:
    from rorg.history.repeats import folded

    for group in folded(events):
        times = f"  (x {group.times} since {group.since[11:19]})" if group.times > 1 else ""
        yield _text({**group.last, "message": group.last["message"] + times}, output)


def _text(event: Any, output: str) -> str:
    """An event in one of the forms; its name is its number."""
    if output == "json":
        return as_json(event)
    if output == "yaml":
        import yaml

        return "---\n" + str(yaml.safe_dump(dict(event), sort_keys=False)).rstrip()
    if output == "name":
        return str(event["seq"])
    at = printable(event["at"][:19].replace("T", " "))
    more = f"  {event['kind']:<12}  {event.get('service') or '-'}" if output == "wide" else ""
    return entry(f"{at}{more}  ", event["message"])


def _kept(context: Context, last: int, only: dict[str, Any]) -> list[dict[str, Any]]:
    from rorg.history.database import reading
    from rorg.history.journal import Filter, Journal

    kinds, services = frozenset(only["kind"]), frozenset(only["service"])
    meant = Filter(kinds, services, only["since"], only["until"], only["text"])
    with reading(context.state.journal) as database:
        return Journal(database).select(meant, last, newest=True)
