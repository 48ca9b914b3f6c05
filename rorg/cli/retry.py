"""rorg retry"""

from __future__ import annotations

from rorg.cli.operations import confirmed, operating
from rorg.cli.options import Output, RobotEngine, ServiceNames, Yes
from rorg.cli.output import print_rows


def command(context: RobotEngine, services: ServiceNames, yes: Yes = False, output: Output = "table") -> None:
    """Retry failed changes without editing anything. Ask first if that replaces a driver or restarts other
    services. `rorg apply --wait` waits for the result.

    Example: rorg retry navigation
    """
    robot = operating(context)
    names = confirmed(lambda force: robot.change("POST /v1/retries", {"services": services}, force), yes, "Retry")
    rows = [{"service": name} for name in names]
    print_rows(rows, output, ("service",), text=f"{', '.join(names)}: the change is tried again")
