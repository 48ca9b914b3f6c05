"""The same commands as typer takes them: for help, for errors, and for every line that is not plain."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable
from functools import cache
from typing import Annotated, Any

import typer
import typer.main

from rorg.cli.commands import ALIASES, COMMANDS, command_of
from rorg.cli.options import Argument
from rorg.cli.signature import Parameter, parameters

UsageError: type[Exception] = typer.BadParameter.__mro__[1]
"""What typer says of a command line; which package it is of depends on typer's version."""

app = typer.Typer(
    name="rorg",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Run a robot's services: declared in YAML, started and ceased by requests.",
    epilog="Exit codes: 0 fine, 1 differences (diff), 2 usage or invalid manifest, 3 engine or daemon unreachable, "
    "4 applied but not ready, 5 refused, 70 internal error.\n\n"
    "Aliases: " + "; ".join(f"{name} is {command}" for name, command in ALIASES.items()) + ".",
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _version(value: bool) -> None:
    if value:
        from rorg import __version__

        typer.echo(f"rorg {__version__}")
        raise typer.Exit()


@app.callback()
def _options(
    version: bool = typer.Option(
        False, "--version", callback=_version, is_eager=True, help="Print the version and exit."
    ),
) -> None:
    pass


def typed(command: Callable[..., Any], run: Callable[..., Any] | None = None) -> Callable[..., Any]:
    """The command with typer's declarations in place of ours. `run` is called instead of it, if given."""
    declared = parameters(command)

    def call(**values: Any) -> None:
        (run or command)(**values)

    call.__doc__ = command.__doc__
    call.__annotations__ = {p.name: Annotated[p.hint, _typers(p)] for p in declared}
    call.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [
            inspect.Parameter(
                p.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=inspect.Parameter.empty if p.required else p.default,
                annotation=call.__annotations__[p.name],
            )
            for p in declared
        ]
    )
    return call


def _typers(parameter: Parameter) -> Any:
    declared = parameter.declared
    if isinstance(declared, Argument):
        complete = _services if declared.service else None
        return typer.Argument(help=declared.help, show_default=declared.show_default, autocompletion=complete)
    return typer.Option(
        *declared.names,
        help=declared.help,
        show_default=declared.show_default,
        envvar=declared.envvar,
        metavar=declared.metavar,
        parser=_told(declared.parser) if declared.parser else None,
        min=declared.least,
        max=declared.most,
    )


def _services(incomplete: str) -> list[str]:
    from rorg.cli.completing import services

    return services(incomplete)


def _told(parser: Callable[[str], Any]) -> Callable[[str], Any]:
    """A parser whose complaint is one about the command line."""

    def parse(text: str) -> Any:
        try:
            return parser(text)
        except ValueError as error:
            raise typer.BadParameter(str(error)) from error

    parse.__name__ = parser.__name__
    return parse


for _name in COMMANDS:
    app.command(_name)(typed(command_of(_name)))

for _name in ALIASES:
    app.command(_name, hidden=True)(typed(command_of(_name)))


@cache
def group() -> Any:
    """All commands, as typer reads a line."""
    return typer.main.get_command(app)


def run_typed(words: list[str]) -> None:
    """Runs what the line says. Raises Invalid for one that says nothing sensible; what a command raises is left alone,
    which typer's own way would not do."""
    try:
        with group().make_context("rorg", list(words) or ["--help"]) as context:
            group().invoke(context)
    except typer.Exit as end:
        sys.exit(end.exit_code)
    except typer.Abort:
        raise KeyboardInterrupt from None
    except UsageError as error:
        from rorg.cli.usage import misread

        raise misread(f"rorg {words[0]}" if words and words[0] in (*COMMANDS, *ALIASES) else "rorg", error) from None
