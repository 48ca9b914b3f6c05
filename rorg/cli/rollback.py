"""rorg rollback"""

from __future__ import annotations

from functools import partial
from typing import Annotated

import typer

from rorg.cli.apply import agree
from rorg.cli.kinds import Seconds
from rorg.cli.names import complete_revisions, complete_services
from rorg.cli.options import Timeout, Tree, WaitFor, Yes
from rorg.cli.output import echo, note

Rev = Annotated[
    str,
    typer.Argument(
        help="REV: a number from `rorg history`, or a commit as in git. Default: the last proven one that changes all "
        "that fails now.",
        autocompletion=complete_revisions,
    ),
]


def command(
    context: Tree,
    revision: Rev = "",
    service: Annotated[
        str,
        typer.Option(
            "--service",
            help="Only this service: its manifest and the files of the tree that it mounts.",
            metavar="SERVICE",
            autocompletion=complete_services,
        ),
    ] = "",
    *,
    printed: Annotated[bool, typer.Option("--print", help="Only print the git commands that make the commit.")] = False,
    yes: Yes = False,
    wait: WaitFor = None,
    timeout: Timeout = Seconds(300),
) -> None:
    """Return to revision REV: show the plan, ask, commit the manifests and image sources of REV, and carry it out.

    Example: rorg rollback HEAD~1 --yes --wait
    """
    from rorg.cli.goals import Known, goal_of
    from rorg.cli.revert import all_committed, go_back, is_copy, restoring, tree_of

    root = tree_of(context)
    all_committed(root, context.robot)
    differs = lambda goal: restoring(root, context.robot, goal, service).differs()  # noqa: E731
    goal = goal_of(revision, Known(context, service), root, differs)
    wanted = restoring(root, context.robot, goal, service)
    if printed:
        echo("\n".join(wanted.commands(clone=is_copy(context, root))))
        return
    what = f"roll {service or 'the manifests'} back"
    agreed = partial(agree, context, what=what, question=f"{wanted.message}?", yes=yes)
    waiting = wait, timeout
    if not go_back(context, root, wanted, agreed, command="rorg rollback", doubt=goal.doubt, waiting=waiting):
        note(f"{wanted.message}: the same already")
