"""rorg exec"""

from __future__ import annotations

import sys
from typing import Annotated

from rorg.cli.options import SERVICES, Argument, EngineName, Option, StateDirectory

Service = Annotated[str, Argument("A running service.", completes=SERVICES)]
NO_PROGRAM = 127


def command(
    service: Service,
    command: Annotated[list[str], Argument("The command, after `--`.")],
    interactive: Annotated[
        bool, Option("Pass standard input to the command; a terminal is always passed.", names=("-i", "--interactive"))
    ] = False,
    terminal: Annotated[
        bool,
        Option(
            "Fail without a terminal. Default: the command gets a terminal if there is one here.", names=("-t", "--tty")
        ),
    ] = False,
    state_dir: StateDirectory = None,
    engine: EngineName = None,
) -> None:
    """Run a command inside a service and exit with its exit code.

    Example: rorg exec navigation -- rosnode list
    """
    from rorg.cli.context import Context
    from rorg.cli.inside import run_inside
    from rorg.cli.output import note
    from rorg.errors import Invalid

    if not command[0]:
        raise Invalid(f"run a command in {service}", "it has no name", f"`rorg exec {service} -- COMMAND`")
    code = run_inside(Context(state_dir, engine), service, command, interactive, terminal)
    if code == NO_PROGRAM:
        note(f"rorg: {command[0]} in {service} gave 127: no such program; try `rorg shell {service}` to look around")
    sys.exit(code)
