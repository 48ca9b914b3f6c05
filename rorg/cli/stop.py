"""rorg stop: `rorg release` for someone who names a service."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer
from rorg_client import NotFound

from rorg.cli.names import complete_requests, complete_services
from rorg.cli.operations import Served, operating
from rorg.cli.options import Output, Robot, Yes
from rorg.cli.release import command as release
from rorg.errors import Missing, StillWanted

if TYPE_CHECKING:
    from rorg_client.types import Why

    from rorg.cli.offline import Local


def command(
    context: Robot,
    id: Annotated[str, typer.Argument(help="Id of the request.", autocompletion=complete_requests)],
    requester: Annotated[
        str, typer.Option("--as", help="Its requester, if several use the same id.", autocompletion=complete_services)
    ] = "",
    yes: Yes = False,
    output: Output = "table",
) -> None:
    """End a request, as `rorg release` does. Exits 1 if a service of this name is still wanted after that, and says who
    holds it.

    Example: rorg stop navigation
    """
    robot = operating(context)
    if robot.requests(id):
        release(context, id, requester, yes, output)
    elif not (known := _known(robot, id)) or not any(one["wanted"] for one in known):
        release(context, id, requester, yes, output)
        return
    for one in _known(robot, id):
        if one["wanted"]:
            raise StillWanted(f"stop {one['service']}", *_held(one))


def _held(one: Why) -> tuple[str, str]:
    """Who holds a service, and what ends that."""
    asked = [(r["id"], r["requester"]) for r in one["requests"]]
    asked = asked or [(link["request"], link["by"]) for link in one["chain"] if link["kind"] == "requested"][:1]
    if asked:
        return "; ".join(f"request '{id}' of {by} holds it" for id, by in asked), f"`rorg release {asked[0][0]}`"
    name = one["service"]
    return one["chain"][0]["text"] if one["chain"] else "it is still wanted", f"`rorg hold {name}`"


def _known(robot: Served | Local, name: str) -> list[Why]:
    """Why services of this name are wanted, or not; empty for an unknown name."""
    try:
        return robot.why(name)
    except (NotFound, Missing):
        return []
