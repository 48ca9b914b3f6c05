"""rorg release"""

from __future__ import annotations

from typing import Annotated

from rorg.cli.options import Argument, Option, StateDirectory
from rorg.cli.output import echo


def command(
    id: Annotated[str, Argument(help="Id of the request.")],
    requester: Annotated[str, Option(names=("--as",), help="Its requester, where several use the same id.")] = "",
    state_dir: StateDirectory = None,
) -> None:
    """Give a request up. Releasing what is already released is fine."""
    from rorg.cli.context import Context
    from rorg.cli.operating import operating
    from rorg.cli.output import note
    from rorg.errors import Invalid

    robot = operating(Context(state_dir, None))
    found = sorted({r for r in robot.requesters(id) if requester in ("", r)})
    if len(found) > 1:
        raise Invalid(f"release '{id}'", f"{' and '.join(found)} have a request of that id", "--as REQUESTER")
    for name in found:
        robot.release(id, name)
        echo(f"request '{id}' of {name} released")
    if not found:
        note(f"there is no request '{id}'; nothing to release")
