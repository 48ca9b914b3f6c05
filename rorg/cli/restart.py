"""rorg restart"""

from __future__ import annotations

from rorg.cli.interlocks import report_locked
from rorg.cli.kinds import Seconds
from rorg.cli.operations import confirmed, operating
from rorg.cli.options import Output, RobotEngine, ServiceName, Timeout, Wait, Yes
from rorg.cli.output import print_rows


def command(
    context: RobotEngine,
    service: ServiceName,
    yes: Yes = False,
    wait: Wait = False,
    timeout: Timeout = Seconds(60),
    output: Output = "table",
) -> None:
    """Stop and start an active service, or each one of a group. Ask first if that stops a driver or other services.

    Example: rorg restart navigation --wait --timeout 30s
    """
    robot = operating(context)
    if wait:
        robot.check_wait(f"wait for {service}")
    before = robot.locked()
    names = confirmed(lambda force: robot.restart(service, force), yes, "Restart")
    text = f"restart of {', '.join(names)} requested"
    print_rows([{"service": name} for name in names], output, ("service",), text=text)
    report_locked(robot.locked, before.keys() - {*names})
    if wait:
        robot.wait([n for n in names if robot.why(n)[0]["wanted"]], timeout)
