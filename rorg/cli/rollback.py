"""rorg rollback"""

from __future__ import annotations

from functools import partial
from typing import Annotated

from rorg.cli.apply import agree
from rorg.cli.options import SERVICES, Argument, Option, Timeout, Tree, Wait, Yes
from rorg.cli.output import echo, note


def command(
    context: Tree,
    revision: Annotated[
        str, Argument("REV: a number from `rorg history`, or a commit as in git. Default: the last proven one.")
    ] = "",
    service: Annotated[str, Option("Only the manifest of this service.", metavar="SERVICE", completes=SERVICES)] = "",
    *,
    printed: Annotated[bool, Option("Only print the git commands that make the commit.", names=("--print",))] = False,
    yes: Yes = False,
    wait: Wait = False,
    timeout: Timeout = 300.0,
) -> None:
    """Return to revision REV: show the plan, ask, commit the manifests and image sources of REV, and carry it out.

    Example: rorg rollback HEAD~1 --yes --wait
    """
    from rorg.cli.revert import Known, all_committed, go_back, goal_of, is_copy, restoring, tree_of

    root = tree_of(context)
    goal = goal_of(revision, Known(context), root)
    if printed:
        echo("\n".join(restoring(root, context.robot, goal, service).commands(clone=is_copy(context, root))))
        return
    all_committed(root, context.robot)
    wanted = restoring(root, context.robot, goal, service)
    what = f"roll {service or 'the manifests'} back"
    agreed = partial(agree, context, what=what, question=f"{wanted.message}?", yes=yes)
    waiting = wait, timeout
    if not go_back(context, root, wanted, agreed, command="rorg rollback", doubt=goal.doubt, waiting=waiting):
        note(f"{wanted.message}: the same already")
