"""rorg diff"""

from __future__ import annotations

import sys

from rorg.cli.options import Directory, EngineName, Output, StateDirectory
from rorg.cli.output import echo


def command(
    directory: Directory = None, state_dir: StateDirectory = None, engine: EngineName = None, output: Output = "table"
) -> None:
    """Show what would be done, and why, without doing it. Exits 1 when there is anything."""
    from rorg.cli.context import Context
    from rorg.cli.output import check_form, dump
    from rorg.errors import Exit

    check_form(output, ("table", "json", "yaml"))
    context = Context(state_dir, engine, directory, local=True)
    plan = context.decision(context.catalog()).plan
    if output == "table":
        echo(plan.text(), end="")
    else:
        dump(plan.as_json(), output)
    sys.exit(int(Exit.OK if plan.empty else Exit.DIFFERENCES))
