"""The same commands as typer takes them: for help, for errors, and for every line that is not plain."""

from __future__ import annotations

import inspect
import sys
from collections.abc import Callable, Mapping
from functools import cache
from typing import Annotated, Any

import typer
import typer.main
from typer.core import TyperCommand

from rorg.cli.commands import ALIASES, COMMANDS, command_of
from rorg.cli.options import Argument, Option, duration, moment
from rorg.cli.output import nobody_reads
from rorg.cli.signature import Parameter, parameters, parted
from rorg.cli.signature import call as calling

UsageError: type[Exception] = typer.BadParameter.__mro__[1]
"""What typer says of a command line; which package it is of depends on typer's version."""

app = typer.Typer(
    name="rorg",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Run a robot's services: declared in YAML, started and ceased by requests.",
    epilog="Exit codes: 0 ok, 1 differences (diff), 2 usage or invalid manifest, 3 engine or daemon unreachable, "
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


def add(
    to: typer.Typer,
    command: Callable[..., Any],
    name: str = "",
    run: Callable[..., Any] | None = None,
    hidden: bool = False,
) -> None:
    """The command with typer's declarations in place of ours. `run` is called instead of it, if given."""
    after: dict[str, list[str]] = {}
    example = about(command)[1]
    to.command(
        name or None, cls=_class(command, after), hidden=hidden, epilog=f"Example: {example}" if example else None
    )(_typed(command, run, after))


def _typed(
    command: Callable[..., Any], run: Callable[..., Any] | None, after: Mapping[str, list[str]]
) -> Callable[..., Any]:
    declared = [p for p in parameters(command) if not p.rest]

    def call(**values: Any) -> None:
        try:
            run(**values, **after) if run else calling(command, {**values, **after})
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


def _class(command: Callable[..., Any], after: dict[str, list[str]]) -> type[TyperCommand]:
    """What typer makes of a command: one that takes all words after `--` as they are puts them into `after`."""
    declared = parameters(command)
    if not any(p.rest for p in declared):
        return TyperCommand

    class Parted(TyperCommand):
        def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
            words, found = parted(declared, args)
            after.update(found)
            left = super().parse_args(ctx, words)
            if not (all(after.values()) or ctx.resilient_parsing):
                ctx.fail(f"Missing {' '.join(after).upper()} after '--'.")
            return left

        def collect_usage_pieces(self, ctx: Any) -> list[str]:
            return [*super().collect_usage_pieces(ctx), *(f"-- {p.name.upper()}..." for p in declared if p.rest)]

    return Parted


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
        metavar=declared.metavar or {duration: "DURATION", moment: "TIME"}.get(declared.parser),  # type: ignore[call-overload]
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
    add(app, command_of(_name), _name)

for _name in ALIASES:
    add(app, command_of(_name), _name, hidden=True)


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
