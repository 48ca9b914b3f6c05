"""rorg diff"""

from __future__ import annotations

import sys

from rorg.cli.options import Directory, EngineName, Output, StateDirectory
from rorg.cli.output import check_form, echo, print_rows


def command(
    directory: Directory = None, state_dir: StateDirectory = None, engine: EngineName = None, output: Output = "table"
) -> None:
    """Show what would be done, and why, without doing it. Exits 1 when there is anything.

    Example: rorg diff manifests
    """
    from rorg.cli.context import Context
    from rorg.cli.differences import differences
    from rorg.errors import Exit

    check_form(output)
    found = differences(Context(state_dir, engine, directory, local=True))
    if output in ("table", "wide"):
        echo(found.text, end="")
    else:
        print_rows(found.plan["actions"], output, ("service",), full=found.plan)
    sys.exit(int(Exit.OK if found.empty else Exit.DIFFERENCES))
