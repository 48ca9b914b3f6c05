"""rorg events"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from rorg.cli.options import Option, Output, StateDirectory
from rorg.cli.output import echo

if TYPE_CHECKING:
    from rorg.cli.context import Context


def command(
    follow: Annotated[bool, Option(names=("-f", "--follow"), help="Follow new entries.")] = False,
    tail: Annotated[int, Option(names=("--tail",), least=0, help="Start with the last so many entries.")] = 20,
    output: Output = "table",
    state_dir: StateDirectory = None,
) -> None:
    """What happened: actions and their outcomes, requests with their authors, refusals, crashes, pressure. JSON comes a
    line an event, YAML a document an event.

    Example: rorg events -f --tail 100
    """
    from rorg.cli.context import Context
    from rorg.cli.output import check_form, end_with_reader

    check_form(output)
    context = Context(state_dir, None)
    needed = follow or not context.state.readable
    client = context.serving("follow events" if follow else "read events") if needed else context.client()
    found = client.events(follow=follow, tail=tail) if client else iter(_last(context, tail))
    if follow:
        end_with_reader()
    for event in found:
        echo(_text(event, output))


def _text(event: Any, output: str) -> str:
    """An event in one of the forms; its name is its number."""
    from rorg.cli.output import as_json
    from rorg.cli.terminal import entry, printable

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


def _last(context: Context, tail: int) -> list[dict[str, Any]]:
    from rorg.history.database import reading
    from rorg.history.journal import Filter, Journal

    with reading(context.state.journal) as database:
        return Journal(database).select(Filter(), tail, newest=True)
