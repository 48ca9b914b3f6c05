"""Arguments and options of commands, as plain values: `cli/plain.py` reads simple command lines by them, and
`cli/app.py` makes typer's parameters of them where help, errors or anything unusual is needed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from rorg.model.engines import ENGINES

FORMS = ("table", "wide", "name", "yaml", "json")
"""Of output."""
SERVICES, GROUPS, REQUESTS = "services", "groups", "requests"
"""What completes a word: names of services and groups; of groups; ids of requests that can be released. Kinds of
manifests do too, such as images."""
NAMES_OF_KIND = "names of kind"
"""Names of the kind that the first argument says."""
FILES, DIRECTORIES = ":files", ":directories"
"""Of the shell."""


class Argument(NamedTuple):
    """A word of the command line that has no name."""

    help: str
    show_default: bool = True
    completes: str | tuple[str, ...] = ()
    """What a shell offers for it: words, or one of the constants above."""
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
    completes: str | tuple[str, ...] = ()
    """What a shell offers for its value, as of an argument."""

    def read(self, text: str) -> Any:
        """The value of its text, by its parser. Raises ValueError."""
        value: Any = self.parser(text) if self.parser else text
        if self.least is not None and value < self.least:
            raise ValueError(f"{text} is too little; {self.least:g} at the least")
        if self.most is not None and value > self.most:
            raise ValueError(f"{text} is too much; {self.most:g} at the most")
        return value


def duration(text: str) -> float:
    """Seconds of "10s", "1m30s" or "10". Raises ValueError."""
    from rorg.model.units import parse_duration

    return parse_duration(f"{text}s" if text.replace(".", "", 1).isdecimal() and text.isascii() else text)


def moment(text: str) -> str:
    """ISO 8601 in UTC of a time, or of so long ago: 10m, 2026-01-31T12:00:00Z. Raises ValueError."""
    import time

    from rorg.model.units import parse_since, stamp

    return stamp(parse_since(text, time.time()))


def words(text: str) -> list[str]:
    """Of a list with commas."""
    return [word for part in text.split(",") if (word := part.strip())]


DIRECTORY = Argument(
    help="Directory of manifests. Default: that of the running rorg, else ./manifests, else the current one, else, "
    "if that holds none, the last one.",
    show_default=False,
    completes=DIRECTORIES,
)
Directory = Annotated[Path | None, DIRECTORY]
MANIFESTS = Option(names=("--manifests",), help="Directory of manifests.", parser=str, completes=DIRECTORIES)
ManifestsDirectory = Annotated[Any, MANIFESTS]
"""The same where a word without a name is something else."""
ROBOT = Option(
    names=("--robot",),
    show_default=False,
    metavar="NAME",
    help="The robot of a fleet, whose robots/NAME/ changes the manifests. Default: RORG_ROBOT, else the name of this "
    "machine if a robot has it, else none.",
)
"""What every command has that takes a directory of manifests."""
STATE_DIR = Option(
    names=("--state-dir",),
    show_default=False,
    completes=DIRECTORIES,
    help="State directory of the robot. Default: RORG_STATE_DIR, else /var/lib/rorg for root, and for others "
    "~/.local/state/rorg.",
)
SOCKET = Option(
    names=("--socket",),
    show_default=False,
    metavar="PATH",
    completes=FILES,
    help="Socket of the running rorg; it replaces the other options. Default: RORG_SOCKET, else the one in the state "
    "directory, else /run/rorg/rorg.sock.",
)
"""What every command has that takes a StateDirectory."""
StateDirectory = Annotated[Path | None, STATE_DIR]
"""Of a command that talks to the running rorg where there is one: it has `--socket` too."""
OwnStateDirectory = Annotated[Path | None, STATE_DIR._replace(help=STATE_DIR.help.replace("the robot", "this robot"))]
"""Of a command that does not."""
EngineName = Annotated[
    str | None,
    Option(
        names=("--engine",),
        envvar="RORG_ENGINE",
        show_default=False,
        help="docker or process. Default: docker.",
        completes=ENGINES,
    ),
]
Output = Annotated[str, Option(names=("-o", "--output"), help="table, wide, name, yaml or json.", completes=FORMS)]
Yes = Annotated[bool, Option(names=("--yes", "-y"), help="Do not ask.")]
Wait = Annotated[bool, Option(names=("--wait",), help="Return when everything is ready; exit 4 if that fails.")]
Timeout = Annotated[
    float,
    Option(names=("--timeout",), parser=duration, metavar="DURATION", help="Longest time to wait: 10s, 5m."),
]
ServiceName = Annotated[str, Argument(help="A service or a group.", completes=SERVICES)]
ServiceNames = Annotated[list[str], Argument(help="Services or groups.", completes=SERVICES)]
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
Reason = Annotated[str, Option(names=("--reason",), help="Why; shown wherever rorg lists this.")]
