"""The same commands as typer takes them: for help, for errors, and for every line that is not plain."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Annotated, Any

import typer

from rorg.cli.commands import COMMANDS, command_of
from rorg.cli.options import Argument, Option, duration
from rorg.cli.output import nobody_reads
from rorg.cli.signature import Parameter, parameters

app = typer.Typer(
    name="rorg",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Run a robot's services: declared in YAML, started and ceased by requests.",
    epilog="Exit codes: 0 fine, 1 differences (diff), 2 usage or invalid manifest, 3 engine or daemon unreachable, "
    "4 applied but not ready, 5 refused, 70 internal error.",
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
        try:
            (run or command)(**values)
        except BrokenPipeError:  # typer takes it for a failure
            nobody_reads()

    call.__doc__ = about(command)[0]
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


def about(command: Callable[..., Any]) -> tuple[str, str]:
    """(what a command does, an example line) of its docstring, whose last paragraph is "Example: rorg ..."."""
    text, _, example = inspect.cleandoc(command.__doc__ or "").partition("\n\nExample: ")
    return text, " ".join(example.split())


def _typers(parameter: Parameter) -> Any:
    declared = parameter.declared
    if isinstance(declared, Argument):
        return typer.Argument(help=declared.help, show_default=declared.show_default)
    timed = declared.parser is duration and parameter.default is not None
    return typer.Option(
        *declared.names,
        help=declared.help,
        show_default=f"{parameter.default:g}s" if timed and declared.show_default else declared.show_default,
        envvar=declared.envvar,
        metavar=declared.metavar,
        parser=_told(declared) if declared.parser else None,
        min=None if declared.parser else declared.least,
        max=None if declared.parser else declared.most,
    )


def _told(option: Option) -> Callable[[Any], Any]:
    """A parser whose complaint is one about the command line. It is given the default too, which is no text."""

    def parse(text: Any) -> Any:
        try:
            return option.read(text) if isinstance(text, str) else text
        except ValueError as error:
            raise typer.BadParameter(str(error)) from error

    parse.__name__ = getattr(option.parser, "__name__", "value")
    return parse


for _name in COMMANDS:
    _command = command_of(_name)
    _example = about(_command)[1]
    app.command(_name, epilog=f"Example: {_example}" if _example else None)(typed(_command))
