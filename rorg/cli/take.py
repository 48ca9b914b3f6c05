"""rorg take"""

from __future__ import annotations

from rorg.cli.operations import operating
from rorg.cli.options import Output, Robot, ServiceNames, Yes
from rorg.cli.output import consent, print_rows


def command(context: Robot, services: ServiceNames, yes: Yes = False, output: Output = "table") -> None:
    """Take services over from a machine that cannot confirm that they have ended there, because it is broken or gone.
    Ask first: if it still runs one of them, that one runs twice.

    Example: rorg take navigation
    """
    client = context.serving(f"take {', '.join(services)}")
    if not yes:
        robot = operating(context)
        waits = [f"{name}: {reason}" for name in services for e in robot.why(name) for reason in e["waits"]]
        told = "; ".join(waits) or "they may still run on another machine"
        consent(
            f"take {', '.join(services)}",
            f"{told}. Confirm that they have stopped there?",
            f"{told}; it needs confirmation",
        )
    for name in services:
        client.call("POST", f"/v1/services/{name}/take")
    rows = [{"service": name} for name in services]
    print_rows(rows, output, ("service",), text=f"{', '.join(services)}: taken over")
