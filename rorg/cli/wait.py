"""rorg wait"""

from __future__ import annotations

from rorg.cli.options import ServiceNames, StateDirectory, Timeout
from rorg.cli.output import echo


def command(services: ServiceNames, timeout: Timeout = 60.0, state_dir: StateDirectory = None) -> None:
    """Return when services, and all that they need, are ready; exit 4 with the reason if they do not get so."""
    from rorg.cli.context import Context
    from rorg.cli.operating import operating

    robot = operating(Context(state_dir, None))
    robot.waiting(f"wait for {', '.join(services)}")
    robot.wait(services, timeout)
    echo(f"{', '.join(services)} ready")
