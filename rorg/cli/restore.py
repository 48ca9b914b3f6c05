"""rorg restore"""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rorg.cli.apply import agree
from rorg.cli.differences import Differences
from rorg.cli.kinds import Seconds
from rorg.cli.names import complete_revisions
from rorg.cli.options import Timeout, Tree, WaitFor, Yes
from rorg.cli.output import note
from rorg.errors import Invalid

if TYPE_CHECKING:
    from rorg.cli.past_requests import EarlierRequests
    from rorg.model.catalog import Catalog


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
    from rorg.cli.revert import all_committed, go_back, past_manifests, restoring, tree_of

    if not at:
        raise Invalid("restore", "no time is named", "`rorg restore --at 10m`")
    root = tree_of(context)
    moment, goal = moment_of(at, Known(context), root, time.time())
    all_committed(root, context.robot)
    wanted, requests = restoring(root, context.robot, goal, ""), EarlierRequests(context, root, moment)
    note(f"as of {moment}, revision {goal.title}")

    def agreed(owner: dict[str, Any] | None, shown: Differences, *, nothing: bool) -> None:
        changes = requests.lines()
        if changes:
            shown = _with_requests(requests, past_manifests(root, context.robot, goal), shown)
        agree(context, owner, shown, "restore", question="Restore that?", yes=yes, nothing=nothing and not changes)

    waiting, then = (wait, timeout), requests.restore
    go_back(context, root, wanted, agreed, command="rorg restore", doubt=goal.doubt, waiting=waiting, then=then)


def _with_requests(requests: EarlierRequests, manifests: Catalog, shown: Differences) -> Differences:
    """Show the changes of requests and what they start and end. The plan, which then shows only the manifests."""
    for line in [*requests.lines(), *requests.effects(manifests)]:
        note(line)
    return shown._replace(plan={**shown.plan, "summary": "No differences of the manifests."}) if shown.empty else shown
