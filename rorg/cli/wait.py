"""rorg wait"""

from __future__ import annotations

from rorg.cli.kinds import Seconds
from rorg.cli.operations import operating
from rorg.cli.options import Output, Robot, ServiceNames, Timeout
from rorg.cli.output import print_rows


def command(context: Robot, services: ServiceNames, timeout: Timeout = Seconds(60), output: Output = "table") -> None:
    """Return when services and everything they need are ready. Exit 4 with the reason if they do not become ready.
    An rorg that is just starting gets 10 seconds.

    Example: rorg wait navigation --timeout 30s
    """
    context.await_start(timeout)
    robot = operating(context)
    robot.check_wait(f"wait for {', '.join(services)}")
    robot.wait(services, timeout)
    rows = [{"service": name, "ready": True} for name in services]
    print_rows(rows, output, ("service", "ready"), text=f"{', '.join(services)} ready")
