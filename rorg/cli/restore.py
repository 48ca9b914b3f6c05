"""rorg restore"""

from __future__ import annotations

import time
from typing import Annotated, Any

import typer

from rorg.cli.apply import agree
from rorg.cli.differences import Differences
from rorg.cli.kinds import Seconds
from rorg.cli.names import complete_revisions
from rorg.cli.options import Timeout, Tree, WaitFor, Yes
from rorg.cli.output import note
from rorg.errors import Invalid


def command(
    context: Tree,
    at: Annotated[
        str,
        typer.Option(
            help="A time, such as 10m (ago) or 2026-01-31T12:00:00Z, or a REV as for `rorg rollback`.",
            metavar="TIME|REV",
            autocompletion=complete_revisions,
        ),
    ] = "",
    yes: Yes = False,
    wait: WaitFor = None,
    timeout: Timeout = Seconds(300),
) -> None:
    """Bring the robot back to an earlier time: its manifests, as `rorg rollback` does, and the requests that people
    had made.

    Example: rorg restore --at 2h --wait
    """
    from rorg.cli.goals import Known, moment_of
    from rorg.cli.past_requests import EarlierRequests
    from rorg.cli.revert import all_committed, go_back, restoring, tree_of

    if not at:
        raise Invalid("restore", "no time is named", "`rorg restore --at 10m`")
    root = tree_of(context)
    moment, goal = moment_of(at, Known(context), root, time.time())
    all_committed(root, context.robot)
    wanted, requests = restoring(root, context.robot, goal, ""), EarlierRequests(context, root, moment)
    note(f"as of {moment}, revision {goal.title}")

    def agreed(owner: dict[str, Any] | None, shown: Differences, *, nothing: bool) -> None:
        for line in requests.lines():
            note(line)
        nothing = nothing and not requests.lines()
        agree(context, owner, shown, "restore", question="Restore that?", yes=yes, nothing=nothing)

    waiting, then = (wait, timeout), requests.restore
    go_back(context, root, wanted, agreed, command="rorg restore", doubt=goal.doubt, waiting=waiting, then=then)
