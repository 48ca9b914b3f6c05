"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def complete_service(incomplete: str) -> list[str]:
    """Names of services and groups for the shell."""
    from rorg.cli.context import Context

    try:
        catalog = Context(None, None).catalog()
    except Exception:
        return []
    return [n for n in (*catalog.services, *catalog.groups) if n.startswith(incomplete)]


def duration(text: str) -> float:
    """Seconds of "10m" or "1m30s"."""
    from rorg.model.units import parse_duration

    try:
        return parse_duration(text)
    except ValueError as error:
        raise typer.BadParameter(str(error)) from error


Directory = Annotated[
    Path | None,
    typer.Argument(
        help="Directory of manifests. Default: that of the running rorg, else ./manifests, else the current one.",
        show_default=False,
    ),
]
StateDirectory = Annotated[
    Path | None,
    typer.Option(
        "--state-dir",
        envvar="RORG_STATE_DIR",
        show_default=False,
        help="State directory of this robot. Default: /var/lib/rorg for root, else ~/.local/state/rorg.",
    ),
]
EngineName = Annotated[
    str | None,
    typer.Option("--engine", envvar="RORG_ENGINE", show_default=False, help="docker or process. Default: docker."),
]
Output = Annotated[str, typer.Option("-o", "--output", help="table, wide, name, yaml or json.")]
Yes = Annotated[bool, typer.Option("--yes", "-y", help="Do not ask.")]
Wait = Annotated[bool, typer.Option("--wait", help="Return when everything is ready; exit 4 if it does not get so.")]
Timeout = Annotated[float, typer.Option("--timeout", help="Seconds to wait at the most.")]
ServiceName = Annotated[str, typer.Argument(help="A service or a group.", autocompletion=complete_service)]
ServiceNames = Annotated[list[str], typer.Argument(help="Services or groups.", autocompletion=complete_service)]
For = Annotated[
    float | None,
    typer.Option(
        "--for", parser=duration, metavar="DURATION", show_default=False, help="How long, such as 10m or 1h30m."
    ),
]
End = Annotated[bool, typer.Option("--end", help="End it now.")]
Reason = Annotated[str, typer.Option("--reason", help="For people: shown in every listing.")]
