"""rorg suspend"""

from __future__ import annotations

from rorg.cli.operations import operating
from rorg.cli.options import End, For, Output, Reason, Robot
from rorg.cli.output import print_rows
from rorg.errors import Invalid
from rorg.model.units import format_duration, format_seconds


def command(
    context: Robot,
    duration: For = None,
    reason: Reason = "",
    end: End = False,
    output: Output = "table",
) -> None:
    """Change nothing for a time, even if services are requested. rorg still shows what it would do.

    Example: rorg suspend --for 1h --reason maintenance
    """
    if not end and not duration:
        raise Invalid("suspend", "a suspension needs a duration", "--for 10m")
    if end and duration:
        raise Invalid("suspend", "--for and --end contradict each other", "one of them")
    robot = operating(context)
    robot.suspend(None if end else {"duration": format_duration(duration or 0.0), "reason": reason})
    text = "no longer suspended" if end else f"suspended for {format_seconds(duration or 0.0)}"
    suspension = {"suspended": not end, "seconds": None if end else duration, "reason": reason}
    print_rows(
        [{"name": "rorg", **suspension}], output, ("name", "suspended", "seconds", "reason"), full=suspension, text=text
    )
