"""Arguments and options of commands, as plain values: `cli/plain.py` reads simple command lines by them, and
`cli/app.py` makes typer's parameters of them where help, errors or anything unusual is needed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple


class Argument(NamedTuple):
    """A word of the command line that has no name."""

    help: str
    show_default: bool = True
    service: bool = False
    """It is the name of a service or a group, which shells complete."""
    rest: bool = False
    """All words after `--`, as they are."""


class Option(NamedTuple):
    """A word with a name, such as `--for 10m`, or a flag."""

    names: tuple[str, ...]
    """None for that of the parameter: --tls-cert for tls_cert."""
    help: str
    show_default: bool = True
    envvar: str | None = None
    metavar: str | None = None
    parser: Callable[[str], Any] | None = None
    """Makes its value of its text; raises ValueError."""
    least: float | None = None
    most: float | None = None


def duration(text: str) -> float:
    """Seconds of "10m" or "1m30s". Raises ValueError."""
    from rorg.model.units import parse_duration

    return parse_duration(text)


Directory = Annotated[
    Path | None,
    Argument(
        help="Directory of manifests. Default: that of the running rorg, else ./manifests, else the current one.",
        show_default=False,
    ),
]
STATE_DIR = Option(
    names=("--state-dir",),
    show_default=False,
    help="State directory of the robot. Default: RORG_STATE_DIR, else /var/lib/rorg for root, and for others "
    "~/.local/state/rorg.",
)
SOCKET = Option(
    names=("--socket",),
    show_default=False,
    metavar="PATH",
    help="Socket of the running rorg: all that is needed where one runs. Default: RORG_SOCKET, else that of the state "
    "directory, else /run/rorg/rorg.sock.",
)
"""What every command has that takes a StateDirectory."""
StateDirectory = Annotated[Path | None, STATE_DIR]
"""Of a command that talks to the running rorg where there is one: it has `--socket` too."""
OwnStateDirectory = Annotated[Path | None, STATE_DIR._replace(help=STATE_DIR.help.replace("the robot", "this robot"))]
"""Of a command that does not."""
EngineName = Annotated[
    str | None,
    Option(names=("--engine",), envvar="RORG_ENGINE", show_default=False, help="docker or process. Default: docker."),
]
Output = Annotated[str, Option(names=("-o", "--output"), help="table, wide, name, yaml or json.")]
Yes = Annotated[bool, Option(names=("--yes", "-y"), help="Do not ask.")]
Wait = Annotated[bool, Option(names=("--wait",), help="Return when everything is ready; exit 4 if it does not get so.")]
Timeout = Annotated[float, Option(names=("--timeout",), help="Seconds to wait at the most.")]
ServiceName = Annotated[str, Argument(help="A service or a group.", service=True)]
ServiceNames = Annotated[list[str], Argument(help="Services or groups.", service=True)]
Rest = Annotated[list[str], Argument(help="A program and its arguments, after `--`.", rest=True)]
For = Annotated[
    float | None,
    Option(
        names=("--for",),
        parser=duration,
        metavar="DURATION",
        show_default=False,
        help="How long, such as 10m or 1h30m.",
    ),
]
End = Annotated[bool, Option(names=("--end",), help="End it now.")]
Reason = Annotated[str, Option(names=("--reason",), help="For people: shown in every listing.")]
