"""rorg diff"""

from __future__ import annotations

import sys

from rorg.cli.options import Directory, EngineName, Output, StateDirectory
from rorg.cli.output import check_form, dump, echo


def command(
    directory: Directory = None, state_dir: StateDirectory = None, engine: EngineName = None, output: Output = "table"
) -> None:
    """Show what would be done, and why, without doing it. Exits 1 when there is anything.

    Example: rorg diff manifests
    """
    from rorg.cli.context import Context
    from rorg.cli.differences import differences
    from rorg.errors import Exit

    check_form(output, ("table", "json", "yaml"))
    found = differences(Context(state_dir, engine, directory, local=True))
    if output == "table":
        echo(found.text, end="")
    else:
        dump(found.plan, output)
    sys.exit(int(Exit.OK if found.empty else Exit.DIFFERENCES))
