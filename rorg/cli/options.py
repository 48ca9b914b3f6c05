"""The arguments and options of commands, as plain values: command_line.py reads a line by them, help.py shows help, and
completions.py completes words."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any, NamedTuple

from rorg.cli.context import Context
from rorg.model.engines import ENGINES
from rorg.model.units import parse_duration, parse_since, stamp

FORMS = ("table", "wide", "name", "yaml", "json")
"""Of output."""
SERVICES, GROUPS, REQUESTS = "services", "groups", "requests"
"""Completions of names: of services and groups; of groups; of requests that can be released. Kinds of manifests, such
as images, are completions too."""
NAMES_OF_KIND = "names of kind"
"""Names of the kind that is the first argument."""
FILES, DIRECTORIES = ":files", ":directories"
"""Completed by the shell."""
KINDS = {
    "service": (SERVICES, "service", "svc"),
    "group": (GROUPS, "group"),
    "image": ("images", "image"),
    "network": ("networks", "network"),
    "volume": ("volumes", "volume"),
    "profile": ("profiles", "profile"),
    "machine": ("machines", "machine"),
    "policy": ("policies", "policy"),
    "request": (REQUESTS, "request"),
}
"""Kind in lower case -> its names in a command line; the first is the folder of its manifests."""


class Argument(NamedTuple):
    """A word of the command line without a name."""

    help: str
    show_default: bool = True
    completes: str | tuple[str, ...] = ()
    """What a shell offers for it: words, or one of the constants above."""
    choices: tuple[str, ...] = ()
    """The only words that it takes; a shell offers them."""
    rest: bool = False
    """It takes all words after `--`, unchanged."""
    kinds: bool = False
    """The command itself reads a kind in front of a name, such as service/navigation; elsewhere that of a service is
    left out."""


class Option(NamedTuple):
    """A word with a name, such as `--for 10m`, or a flag."""

    help: str
    names: tuple[str, ...] = ()
    """Default: the name of the parameter, --tls-cert for tls_cert."""
    show_default: bool = True
    envvar: str | None = None
    metavar: str | None = None
    """Name of its value in the help. Default: DURATION or TIME, if that is what it parses."""
    parser: Callable[[str], Any] | None = None
    """Makes the value from its text. Raises ValueError."""
    least: float | None = None
    most: float | None = None
    completes: str | tuple[str, ...] = ()
    choices: tuple[str, ...] = ()
    """As of an argument, for the value."""
    bare: str = ""
    """The value of the name alone; then any other needs a `=`, as in `--wait=proven`."""

    def read(self, text: str) -> Any:
        """The value of a text, by the parser. Raises ValueError."""
        return self.within(self.parser(text) if self.parser else text, text)

    def within(self, value: Any, text: str) -> Any:
        """The value, if it is within the limits. Raises ValueError."""
        if self.least is not None and value < self.least:
            raise ValueError(f"{text} is too small; the minimum is {self.least:g}")
        if self.most is not None and value > self.most:
            raise ValueError(f"{text} is too large; the maximum is {self.most:g}")
        return value


def duration(text: str) -> float:
    """Seconds of "10s", "1m30s" or "10". Raises ValueError."""
    return parse_duration(f"{text}s" if text.replace(".", "", 1).isdecimal() and text.isascii() else text)


def moment(text: str) -> str:
    """ISO 8601 in UTC of a time, or of so long ago: 10m, 2026-01-31T12:00:00Z. Raises ValueError."""
    return stamp(parse_since(text, time.time()))


def words(text: str) -> list[str]:
    """The words of a list with commas."""
    return [word for part in text.split(",") if (word := part.strip())]


DIRECTORY = Argument(
    "Directory of manifests. Default: that of the running rorg, or ./manifests, or the current one, or, if that has "
    "none, the last one.",
    show_default=False,
    completes=DIRECTORIES,
)
Directory = Annotated[Path | None, DIRECTORY]
MANIFESTS = Option("Directory of manifests.", names=("--manifests",), completes=DIRECTORIES)
ManifestsDirectory = Annotated[Path | None, MANIFESTS]
"""For commands whose first argument is something else."""
ROBOT = Option(
    "The robot of a fleet, whose robots/NAME/ changes the manifests. Default: RORG_ROBOT, or the name of this "
    "machine if a robot has it.",
    names=("--robot",),
    show_default=False,
    metavar="NAME",
)
"""Every command that takes a directory of manifests has it."""
STATE_DIR = Option(
    "State directory of the robot. Default: RORG_STATE_DIR, or /var/lib/rorg for root and ~/.local/state/rorg for "
    "other users.",
    names=("--state-dir",),
    show_default=False,
    completes=DIRECTORIES,
)
SOCKET = Option(
    "Socket of the running rorg; it replaces the other options. Default: RORG_SOCKET, or the one in the state "
    "directory, or /run/rorg/rorg.sock.",
    names=("--socket",),
    show_default=False,
    metavar="PATH",
    completes=FILES,
)
"""Every command with StateDirectory has it."""
ON_MACHINE = Option(
    "Ask this machine of the robot, through the running rorg here. For commands that read.",
    names=("--on",),
    show_default=False,
    metavar="NAME",
)
"""The same."""
StateDirectory = Annotated[Path | None, STATE_DIR]
"""For commands that call the running rorg: they also have `--socket`."""
OwnStateDirectory = Annotated[Path | None, STATE_DIR._replace(help=STATE_DIR.help.replace("the robot", "this robot"))]
"""For commands that do not."""
EngineName = Annotated[
    str | None,
    Option(
        "docker or process. Default: docker.",
        names=("--engine",),
        envvar="RORG_ENGINE",
        show_default=False,
        choices=ENGINES,
    ),
]


class ContextOptions(NamedTuple):
    """The options that make a command's Context: signature.py adds them to those that the command declares itself."""

    engine: bool = True
    directory: Any = None
    """Directory, or ManifestsDirectory for commands whose first argument is something else."""
    local: bool = False
    own: bool = False
    """As of a Context."""

    @property
    def hints(self) -> dict[str, Any]:
        """Parameter of a Context -> its option."""
        state_dir = OwnStateDirectory if self.own else StateDirectory
        options = {"directory": self.directory, "state_dir": state_dir, "engine": EngineName if self.engine else None}
        return {name: hint for name, hint in options.items() if hint}


Robot = Annotated[Context, ContextOptions(engine=False)]
RobotEngine = Annotated[Context, ContextOptions()]
RobotManifests = Annotated[Context, ContextOptions(directory=ManifestsDirectory)]
Tree = Annotated[Context, ContextOptions(directory=ManifestsDirectory, local=True)]
BuildTree = Annotated[Context, ContextOptions(directory=ManifestsDirectory, local=True, own=True)]
TreeDirectory = Annotated[Context, ContextOptions(directory=Directory, local=True)]
TreeAlone = Annotated[Context, ContextOptions(engine=False, directory=Directory, local=True)]
RunTree = Annotated[Context, ContextOptions(directory=Directory, local=True, own=True)]
Output = Annotated[str, Option("table, wide, name, yaml or json.", names=("-o", "--output"), choices=FORMS)]
Yes = Annotated[bool, Option("Do not ask.", names=("--yes", "-y"))]
Wait = Annotated[bool, Option("Return when everything is ready; exit 4 if that fails.", names=("--wait",))]
Timeout = Annotated[float, Option("Longest time to wait: 10s, 5m.", names=("--timeout",), parser=duration)]
ServiceName = Annotated[str, Argument("A service or a group.", completes=SERVICES)]
ServiceNames = Annotated[list[str], Argument("Services or groups.", completes=SERVICES)]
Rest = Annotated[list[str], Argument("A program and its arguments, after `--`.", rest=True)]
For = Annotated[
    float | None, Option("How long, such as 10m or 1h30m.", names=("--for",), parser=duration, show_default=False)
]
End = Annotated[bool, Option("End it now.", names=("--end",))]
Reason = Annotated[str, Option("Why; shown wherever rorg lists this.", names=("--reason",))]
Since = Annotated[str | None, Option("Start: 10m (ago), or 2026-01-31T12:00:00Z. Default: 24h.", parser=moment)]
Until = Annotated[str | None, Option("End. Default: now.", parser=moment)]


def period(since: str | None, until: str | None) -> tuple[str, str]:
    """The times of Since and Until: by default the last day. ISO 8601 in UTC."""
    return since or moment("24h"), until or moment("0s")
