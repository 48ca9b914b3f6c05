"""rorg suspend"""

from __future__ import annotations

from rorg.cli.options import End, For, Reason, StateDirectory
from rorg.cli.output import echo


def command(duration: For = None, reason: Reason = "", end: End = False, state_dir: StateDirectory = None) -> None:
    """Change nothing for a time, whatever is asked for; what would be done is still shown. It ends by itself."""
    import time
    from dataclasses import replace

    from rorg.cli.context import Context
    from rorg.errors import Invalid
    from rorg.model.catalog import Hold
    from rorg.model.units import format_seconds

    if not end and not duration:
        raise Invalid("suspend", "it must end by itself", "--for 10m")
    context = Context(state_dir, None)
    client = context.client()
    if client:
        client.unsuspend() if end else client.suspend(duration or 0.0, reason)
    else:
        hold = None if end else Hold(time.time() + (duration or 0.0), reason)
        context.change(lambda document: replace(document, suspended=hold))
    echo("no longer suspended" if end else f"suspended for {format_seconds(duration or 0.0)}")
