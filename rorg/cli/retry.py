"""rorg retry"""

from __future__ import annotations

from rorg.cli.context import Context
from rorg.cli.operations import confirmed, operating
from rorg.cli.options import EngineName, Output, ServiceNames, StateDirectory, Yes
from rorg.cli.output import print_rows


def command(
    services: ServiceNames,
    yes: Yes = False,
    output: Output = "table",
    state_dir: StateDirectory = None,
    engine: EngineName = None,
) -> None:
    """Retry failed changes without editing anything. Ask first if that replaces a driver or restarts other
    services. `rorg apply --wait` waits for the result.

    Example: rorg retry navigation
    """
    robot = operating(Context(state_dir, engine))
    names = confirmed(lambda force: robot.retry(services, force), yes, "Retry")
    rows = [{"service": name} for name in names]
    print_rows(rows, output, ("service",), text=f"{', '.join(names)}: the change is tried again")
