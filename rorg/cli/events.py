"""rorg events"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from rorg.cli.options import Option, Output, StateDirectory
from rorg.cli.output import echo

if TYPE_CHECKING:
    from rorg.store.journal import Journal


def command(
    follow: Annotated[bool, Option(names=("-f", "--follow"), help="Go on with what comes.")] = False,
    tail: Annotated[int, Option(names=("--tail",), least=0, help="Begin with the last so many.")] = 20,
    output: Output = "table",
    state_dir: StateDirectory = None,
) -> None:
    """What happened: actions and their outcomes, requests with their authors, refusals, crashes, pressure."""
    from rorg.cli.context import Context
    from rorg.cli.output import as_json, check_form
    from rorg.cli.terminal import entry, printable
    from rorg.store.journal import Journal

    check_form(output, ("table", "json"))
    context = Context(state_dir, None)
    needed = follow or not context.state.readable
    client = context.serving("follow events" if follow else "read events") if needed else context.client()
    found = client.events(follow=follow, tail=tail) if client else iter(_last(Journal(context.state.journal), tail))
    for event in found:
        at = f"{printable(event['at'][:19].replace('T', ' '))}  "
        echo(as_json(event) if output == "json" else entry(at, event["message"]))


def _last(journal: Journal, tail: int) -> list[dict[str, Any]]:
    return journal.since(max(0, journal.last - tail))
