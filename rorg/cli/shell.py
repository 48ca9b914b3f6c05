"""rorg shell"""

from __future__ import annotations

import sys

from rorg.cli.exec import NO_PROGRAM, Service, run_inside
from rorg.cli.options import RobotEngine
from rorg.cli.output import note

BASH_OR_SH = ("/bin/sh", "-c", "if command -v bash >/dev/null 2>&1; then exec bash; else exec sh; fi")


def command(context: RobotEngine, service: Service) -> None:
    """Open a shell inside a service, with its environment and working directory: bash, or sh if there is no bash.

    Example: rorg shell navigation
    """
    code = run_inside(context, service, BASH_OR_SH, True, False)
    if code == NO_PROGRAM:
        note(f"rorg: {service}: exit code 127; if it has no shell, try `rorg exec {service} -- COMMAND`")
    sys.exit(code)
