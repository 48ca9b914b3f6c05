"""rorg hold"""

from __future__ import annotations

from rorg.cli.interlocks import report_locked
from rorg.cli.operations import confirmed, operating
from rorg.cli.options import End, For, Output, Reason, RobotEngine, ServiceNames, Yes
from rorg.cli.output import print_rows
from rorg.errors import Invalid
from rorg.model.units import format_duration, format_seconds


def command(
    context: RobotEngine,
    services: ServiceNames,
    *,
    duration: For = None,
    reason: Reason = "",
    end: End = False,
    yes: Yes = False,
    output: Output = "table",
) -> None:
    """Keep services idle for a time, regardless of who requests them. Ask first if that stops a driver or other
    services.

    Example: rorg hold arm --for 10m --reason calibration
    """
    if not end and not duration:
        raise Invalid(f"hold {', '.join(services)}", "a hold needs a duration", "--for 10m")
    if end and duration:
        raise Invalid(f"hold {', '.join(services)}", "--for and --end contradict each other", "one of them")
    length = None if end else format_duration(duration or 0.0)
    body = {"services": services, "duration": length, "reason": reason}
    robot = operating(context)
    before = robot.locked()
    names = confirmed(lambda force: robot.change("PUT /v1/holds", body, force), yes, "Hold")
    text = f"{', '.join(names)} " + ("no longer held" if end else f"held for {format_seconds(duration or 0.0)}")
    rows = [{"service": n, "held": not end, "seconds": None if end else duration, "reason": reason} for n in names]
    print_rows(rows, output, ("service", "held", "seconds", "reason"), text=text)
    report_locked(robot.locked, before.keys() - {*names})
