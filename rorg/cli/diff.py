"""rorg diff"""

from __future__ import annotations

import os
import sys
from typing import Annotated, Any

import typer

from rorg.cli.context import Context
from rorg.cli.differences import Differences, differences, line, past_of, tree_of, warn_of_other_tree
from rorg.cli.names import complete_revisions, complete_services
from rorg.cli.options import DirectoryOrRev, EngineName, Form, StateDirectory
from rorg.cli.output import dump, echo, note, print_rows
from rorg.cli.terminal import printable
from rorg.errors import Exit, Invalid

Rev = Annotated[
    str,
    typer.Argument(
        help="Compare with a revision as if it were in force: a number from rorg history, a commit, a tag or a"
        " branch. A..B compares the manifests of two.",
        autocompletion=complete_revisions,
    ),
]
Unified = Annotated[
    bool,
    typer.Option(
        "--unified", "-u", help="Show a unified diff of each container that changes; possible secrets are masked."
    ),
]
Output = Annotated[
    Form, typer.Option("-o", "--output", help="table: one line per service; wide: every step; name, yaml or json.")
]


def command(
    directory: DirectoryOrRev = None,
    rev: Rev = "",
    service: Annotated[
        str, typer.Option("--service", help="Only this service.", metavar="SERVICE", autocompletion=complete_services)
    ] = "",
    *,
    unified: Unified = False,
    state_dir: StateDirectory = None,
    engine: EngineName = None,
    output: Output = "table",
) -> None:
    """Show what rorg would do, and why, without doing it. Exit 1 if there are differences.

    Example: rorg diff HEAD~1
    """
    if directory and not (rev or os.path.isdir(directory) or str(directory).startswith(("/", "../"))):
        directory, rev = None, str(directory)
    if service and output == "wide":
        raise Invalid("show every step of one service", "steps are those of the whole plan", "-o table, or -u")
    context = Context(state_dir, engine, directory, local=True)
    if ".." in rev:
        return _between(context, rev, service, unified, output)
    comparison = differences(context, unified, rev)
    warn_of_other_tree(context, comparison)
    for warning in comparison.warnings:
        note(line(warning))
    if service:
        comparison = _only(comparison, service)
    if output in ("json", "yaml"):
        dump(_full(comparison, unified), output)
    elif output == "name":
        for entry in comparison.services:
            echo(printable(entry["service"]))
    elif unified:
        echo("".join(comparison.unified.values()), end="")
    else:
        echo(comparison.text if output == "wide" else comparison.overview(), end="")
    sys.exit(int(Exit.OK if comparison.empty else Exit.DIFFERENCES))


def _between(context: Context, rev: str, service: str, unified: bool, output: str) -> None:
    """Shows what changed between two states from the history, A..B; an empty name is HEAD, as with git."""
    from rorg.core.changed_fields import manifest_changes
    from rorg.host.git_edit import SHORT
    from rorg.host.git_process import git_command

    context.here("compare states of the manifests")
    before, _, after = rev.partition("..")
    tree = tree_of(context)
    old, new = (past_of(context, tree, name or "HEAD") for name in (before, after))
    if unified or output == "wide":
        why = "two states of the manifests have no containers and no steps"
        command = git_command(context.root, "diff", f"{old.commit[:SHORT]}..{new.commit[:SHORT]}", "--", ".")
        raise Invalid(f"compare {rev} in that form", why, f"`{command}`")
    changes = [
        c for c in manifest_changes(old.desired, new.desired) if not service or (c.kind, c.name) == ("Service", service)
    ]
    rows = [{**c.as_json(), "change": c.verb, "fields": "; ".join(map(str, c.changes))} for c in changes]
    full = {"from": old.commit, "to": new.commit, "changes": [c.as_json() for c in changes]}
    columns = ("name", "kind", "change", "fields")
    print_rows(rows, output, columns, full=full, below=("fields",), text=None if changes else "No differences.")
    sys.exit(int(Exit.DIFFERENCES if changes else Exit.OK))


def _only(comparison: Differences, name: str) -> Differences:
    services = [s for s in comparison.services if s["service"] == name]
    actions, waitings = ([a for a in comparison.plan[kind] if a["service"] == name] for kind in ("actions", "waitings"))
    summary = "" if services else f"No differences of {name}."
    return comparison._replace(
        services=services,
        unified={n: text for n, text in comparison.unified.items() if n == name},
        plan={**comparison.plan, "actions": actions, "waitings": waitings, "summary": summary},
        empty=not services,
    )


def _full(comparison: Differences, unified: bool) -> dict[str, Any]:
    """The plan for programs."""
    services = [{k: v for k, v in s.items() if k != "line"} for s in comparison.services]
    return {**comparison.plan, "services": services, **({"unified": comparison.unified} if unified else {})}
