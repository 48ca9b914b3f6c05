"""Arguments and options that several commands share, and the Context that some of the options make."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable
from functools import partial, wraps
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, get_args

import typer

from rorg.cli.context import ROBOT as ROBOT_VARIABLE
from rorg.cli.context import Context
from rorg.cli.kinds import DIRECTORY, FILE, duration, moment, service_name
from rorg.cli.names import DirectoryOrRevision, complete_services
from rorg.cli.places import socket_of
from rorg.errors import Invalid

Form = Literal["table", "wide", "name", "yaml", "json"]
"""A form of output."""
FORMS: tuple[str, ...] = get_args(Form)

Directory = Annotated[
    Path | None,
    typer.Argument(
        help="Directory of manifests (default: the running rorg's, else ./manifests).",
        click_type=DIRECTORY,
    ),
]
DirectoryOrRev = Annotated[
    Path | None,
    typer.Argument(
        help="Directory of manifests (default: the running rorg's, else ./manifests).",
        click_type=DirectoryOrRevision("dir"),
    ),
]
ManifestsDirectory = Annotated[
    Path | None, typer.Option("--manifests", help="Directory of manifests.", click_type=DIRECTORY)
]
"""For commands whose first argument is something else."""
RobotName = Annotated[
    str | None,
    typer.Option(
        "--robot",
        help="The robot of a fleet, whose robots/NAME/ changes the manifests. Default: RORG_ROBOT, or the name of this "
        "machine if a robot has it.",
        metavar="NAME",
    ),
]
"""Every command that takes a directory of manifests has it."""
STATE_DIR = partial(
    typer.Option,
    "--state-dir",
    help="State directory of the robot. Default: RORG_STATE_DIR, or /var/lib/rorg for root and ~/.local/state/rorg for "
    "other users.",
    click_type=DIRECTORY,
)
StateDirectory = Annotated[Path | None, STATE_DIR()]
"""For commands that call the running rorg: they also have `--socket` and `--on`."""
OwnStateDirectory = Annotated[Path | None, STATE_DIR()]
"""For commands that do not."""
Socket = Annotated[
    Path | None,
    typer.Option(
        "--socket",
        help="Socket of the running rorg; it replaces the other options. Default: RORG_SOCKET, or the one in the state "
        "directory, or /run/rorg/rorg.sock.",
        click_type=FILE,
    ),
]
OnMachine = Annotated[
    str | None,
    typer.Option(
        "--on",
        help="Ask this machine of the robot, through the running rorg here. For commands that read.",
        metavar="NAME",
    ),
]
"""Every command that calls the running rorg has these two."""
Engine = Literal["docker", "process", "swarm"]
EngineName = Annotated[
    Engine | None,
    typer.Option("--engine", help="docker or process. Default: docker.", envvar="RORG_ENGINE"),
]
SHARED = ("--state-dir", "--socket", "--engine", "--robot", "--on")
"""Explained once, by `rorg help options`."""


class ContextOptions(NamedTuple):
    """The options that make a command's Context."""

    engine: bool = True
    directory: Any = None
    """Directory, or ManifestsDirectory for commands whose first argument is something else."""
    local: bool = False
    own: bool = False
    """As of a Context."""

    @property
    def hints(self) -> dict[str, Any]:
        """Parameter of a Context -> its option."""
        state_dir, engine = OwnStateDirectory if self.own else StateDirectory, EngineName if self.engine else None
        options = {"directory": self.directory, "state_dir": state_dir, "engine": engine}
        return {name: hint for name, hint in options.items() if hint}

    def context(self, values: dict[str, Any]) -> Context:
        """The Context of these values, which are taken out."""
        return Context(**{name: values.pop(name) for name in self.hints}, local=self.local, own=self.own)


Robot = Annotated[Context, ContextOptions(engine=False)]
RobotEngine = Annotated[Context, ContextOptions()]
RobotManifests = Annotated[Context, ContextOptions(directory=ManifestsDirectory)]
Tree = Annotated[Context, ContextOptions(directory=ManifestsDirectory, local=True)]
BuildTree = Annotated[Context, ContextOptions(directory=ManifestsDirectory, local=True, own=True)]
TreeDirectory = Annotated[Context, ContextOptions(directory=Directory, local=True)]
TreeAlone = Annotated[Context, ContextOptions(engine=False, directory=Directory, local=True)]
RunTree = Annotated[Context, ContextOptions(directory=Directory, local=True, own=True)]
"""For a command's first parameter."""
Output = Annotated[Form, typer.Option("-o", "--output", help="table, wide, name, yaml or json.", metavar="FORM")]
NoHeaders = Annotated[bool, typer.Option("--no-headers", help="Print the table without its first line.")]
Yes = Annotated[bool, typer.Option("--yes", "-y", help="Do not ask.")]
Wait = Annotated[bool, typer.Option("--wait", help="Return when everything is ready; exit 4 if that fails.")]
WaitFor = Annotated[
    Literal["ready", "proven"] | None,
    typer.Option(
        "--wait",
        help="Return when everything is ready, or with =proven when it has also stayed well; exit 4 if that fails.",
        metavar="[=ready|proven]",
    ),
]
"""For commands that change the manifests: they can also wait for the bake of what changes."""
Timeout = Annotated[float, typer.Option("--timeout", help="Longest time to wait: 10s, 5m.", parser=duration)]
ServiceName = Annotated[
    str, typer.Argument(help="A service or a group.", parser=service_name, autocompletion=complete_services)
]
ServiceNames = Annotated[
    list[str], typer.Argument(help="Services or groups.", parser=service_name, autocompletion=complete_services)
]
For = Annotated[float | None, typer.Option("--for", help="How long, such as 10m or 1h30m.", parser=duration)]
End = Annotated[bool, typer.Option("--end", help="End it now.")]
Reason = Annotated[str, typer.Option("--reason", help="Why; shown wherever rorg lists this.")]
Since = Annotated[
    str | None, typer.Option(help="Start: 10m (ago), or 2026-01-31T12:00:00Z. Default: 24h.", parser=moment)
]
Until = Annotated[str | None, typer.Option(help="End. Default: now.", parser=moment)]


def period(since: str | None, until: str | None) -> tuple[str, str]:
    """The times of Since and Until: by default the last day. ISO 8601 in UTC."""
    return since or moment("24h"), until or moment("0s")


def with_shared_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """A command as typer reads it: with the options that make its Context in place of that, and those that every
    command of its kind has."""
    signature = inspect.signature(command, eval_str=True)
    own, contexts = [], dict[str, ContextOptions]()
    for parameter in signature.parameters.values():
        declared = (get_args(parameter.annotation) or (None,))[-1]
        if isinstance(declared, ContextOptions):
            contexts[parameter.name] = declared
        else:
            own.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))
    hints = {name: hint for options in contexts.values() for name, hint in options.hints.items()}
    hints |= _place_options([p.annotation for p in own] + list(hints.values()))

    @wraps(command)
    def run(**values: Any) -> None:
        _apply_place(values)
        command(**{name: options.context(values) for name, options in contexts.items()}, **values)

    del run.__wrapped__  # its signature would count
    shared = [
        inspect.Parameter(n, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=h) for n, h in hints.items()
    ]
    run.__signature__ = inspect.Signature([*own, *shared])  # type: ignore[attr-defined]
    run.__annotations__ = {}
    return run


def _place_options(hints: list[Any]) -> dict[str, Any]:
    """The options that commands have without declaring them, because they have these."""
    found: dict[str, Any] = {}
    if not {Directory, DirectoryOrRev, ManifestsDirectory}.isdisjoint(hints):
        found["robot"] = RobotName
    if StateDirectory in hints:
        found |= {"socket": Socket, "on_machine": OnMachine}
    return found


def _apply_place(values: dict[str, Any]) -> None:
    """Puts `--socket`, `--on` and `--robot` into the environment, for everything that looks for rorg or reads
    manifests, and for programs that the command starts. Raises Invalid if two places are given."""
    if robot := values.pop("robot", None):
        os.environ[ROBOT_VARIABLE] = robot
    if socket := values.pop("socket", None):
        if values.get("state_dir"):
            raise Invalid("look in two places", "--socket and --state-dir each name one", "one of them")
        os.environ["RORG_SOCKET"] = str(socket)
    if machine := values.pop("on_machine", None):
        os.environ["RORG_SOCKET"], values["state_dir"] = socket_of(machine, values.get("state_dir")), None
