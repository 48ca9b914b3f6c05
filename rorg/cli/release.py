"""rorg release"""

from __future__ import annotations

from typing import Annotated

import typer

from rorg.cli.names import complete_requests, complete_services
from rorg.cli.operations import confirmed, operating
from rorg.cli.options import Output, Robot, Yes
from rorg.cli.output import note, print_rows
from rorg.errors import Invalid


def command(
    context: Robot,
    id: Annotated[str, typer.Argument(help="Id of the request.", autocompletion=complete_requests)],
    requester: Annotated[
        str, typer.Option("--as", help="Its requester, if several use the same id.", autocompletion=complete_services)
    ] = "",
    yes: Yes = False,
    output: Output = "table",
) -> None:
    """End a request. Releasing twice is fine. Ask first if a driver in the request would stop, or if a service
    still uses what the request asked for.

    Example: rorg release tour
    """
    from functools import partial

    robot = operating(context)
    requesters = sorted({r["requester"] for r in robot.requests(id) if requester in ("", r["requester"])})
    if len(requesters) > 1:
        raise Invalid(f"release '{id}'", f"{' and '.join(requesters)} have a request with that id", "--as REQUESTER")
    for name in requesters:
        confirmed(partial(robot.release, id, name), yes, "Release")
    text = "\n".join(f"request '{id}' of {name} released" for name in requesters)
    print_rows([{"id": id, "requester": name} for name in requesters], output, ("id", "requester"), text=text)
    if not requesters:
        note(f"no request '{id}': nothing to release")
