"""The command line as typer reads it. A command is imported when it is called, not before: the group knows names and
summaries from commands.py."""

from __future__ import annotations

import inspect
from functools import cache
from typing import Annotated, Any

import typer
from typer._click import Context, Parameter
from typer._click.exceptions import UsageError
from typer._click.shell_completion import CompletionItem
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from rorg.cli.commands import ALIASES, COMMANDS, GROUPS, SUMMARIES, command_of
from rorg.cli.mistakes import unknown
from rorg.cli.options import SHARED, with_shared_options

ABOUT = "Run a robot's services: declared in YAML, started and stopped on request."
ALIASES_TEXT = "Aliases: " + "; ".join(f"{name} is {command}" for name, command in ALIASES.items()) + "."
EXITS = (
    "Exit codes: 0 ok, 1 differences (diff) or still wanted (stop), 2 usage or invalid manifest, 3 engine or daemon "
    "unreachable, 4 applied but not ready, 5 refused, 70 internal error."
)
BARE = {"--wait": "ready"}
"""Option that takes a value after `=` -> the value of the option alone. typer has no options with an optional value."""
SETTINGS: dict[str, Any] = {"help_option_names": ["-h", "--help"], "max_content_width": 100}
APP: dict[str, Any] = {"add_completion": False, "rich_markup_mode": None, "pretty_exceptions_enable": False}
"""Without what would import rich, or show another traceback than Python's."""
Rows = list[tuple[str, str]]
"""Parameters as the help shows them, and their meanings."""


class Command(TyperCommand):
    """One command. Its help names the options that many commands share, without explaining them again."""

    def __init__(self, *args: Any, **settings: Any) -> None:
        """`program` is a second list of words, which typer would refuse: all words after `--`."""
        super().__init__(*args, **settings)
        for argument in (p for p in self.params if p.param_type_name == "argument"):
            argument.metavar = argument.metavar or str(argument.name).upper()
        lists = [p for p in self.params if p.nargs == -1]
        self.program = lists[1] if len(lists) > 1 else None
        if self.program:
            self.params.remove(self.program)

    @property
    def arguments(self) -> list[Parameter]:
        """Those of its usage line."""
        return [*(p for p in self.params if p.param_type_name == "argument"), *filter(None, [self.program])]

    def parse_args(self, ctx: Context, args: list[str]) -> list[str]:
        """As typer does, but `--wait` alone has a value, and the program is what follows `--`."""
        end = args.index("--") if "--" in args else len(args)
        own, after = [self._with_value(word) for word in args[:end]], args[end:]
        try:
            rest = super().parse_args(ctx, own if self.program else own + after)
        except UsageError as error:
            error.ctx = error.ctx or ctx  # the parser itself does not say of which command a mistake is
            raise
        if self.program:
            if not after[1:] and not ctx.resilient_parsing:
                ctx.fail(f"Missing argument '{argument_name(self.program)}' after --")
            ctx.params[str(self.program.name)] = after[1:]
        return rest

    def _with_value(self, word: str) -> str:
        valued = word in BARE and any(word in p.opts and not getattr(p, "is_flag", False) for p in self.params)
        return f"{word}={BARE[word]}" if valued else word

    def collect_usage_pieces(self, _ctx: Context) -> list[str]:
        """`[OPTIONS]` and the arguments, as other programs write them."""
        return ["[OPTIONS]", *map(usage, self.arguments)]

    def format_options(self, ctx: Context, formatter: Any) -> None:
        """The arguments, and the options except those that many commands share."""
        arguments, options, shared = parts(self, ctx)
        for title, rows in (("Arguments", arguments), ("Options", options)):
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)
        if shared:
            formatter.write_paragraph()
            with formatter.indentation():
                formatter.write_text(
                    f"More options: {', '.join(name.split()[0] for name, _ in shared)}; see `rorg help options`."
                )


class Commands(TyperGroup):
    """All commands, none of them imported before it is called."""

    def list_commands(self, _ctx: Context) -> list[str]:
        """Their names, in the order of the help."""
        return list(COMMANDS)

    def get_command(self, _ctx: Context, cmd_name: str) -> Command | None:
        """The command of a name or an alias."""
        return typer_command(cmd_name) if cmd_name in (*COMMANDS, *ALIASES) else None

    def resolve_command(self, ctx: Context, args: list[str]) -> tuple[str | None, Command | None, list[str]]:
        """(its name, the command, the words after it). Raises Invalid for an unknown one."""
        found = self.get_command(ctx, args[0])
        if not (found or ctx.resilient_parsing):
            raise unknown(args[0])
        return args[0] if found else None, found, args[1:]

    def shell_complete(self, _ctx: Context, incomplete: str) -> list[CompletionItem]:
        """Names and summaries, or options of `rorg` itself. Imports no command."""
        if incomplete.startswith("-"):
            return [CompletionItem(name) for name in ("--help", "--version") if name.startswith(incomplete)]
        found = {name: summary for name, summary in SUMMARIES.items() if name.startswith(incomplete)}
        return [CompletionItem(name, help=summary) for name, summary in found.items()]

    def format_commands(self, _ctx: Context, formatter: Any) -> None:
        """One table for each group of commands."""
        width = max(map(len, COMMANDS))
        for title, commands in GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(name.ljust(width), summary) for name, summary in commands.items()])

    def format_epilog(self, _ctx: Context, formatter: Any) -> None:
        """Exit codes and aliases."""
        with formatter.indentation():
            for text in (EXITS, ALIASES_TEXT):
                formatter.write_paragraph()
                formatter.write_text(text)


def usage(argument: Parameter) -> str:
    """An argument as written in the usage line of its command."""
    text = argument_name(argument) + ("..." if argument.nargs == -1 else "")
    text = text if argument.required else f"[{text}]"
    return f"-- {text}" if argument.name == "program" else text


def argument_name(argument: Parameter) -> str:
    """Its name in usage lines and errors."""
    return argument.human_readable_name


def parts(command: Command, ctx: Context) -> tuple[Rows, Rows, Rows]:
    """The arguments, the options, and the options that many commands share."""
    arguments = [(argument_name(p), _record(p, ctx)[1]) for p in command.arguments]
    options = [p for p in command.get_params(ctx) if p not in command.arguments]
    shared = [p for p in options if p.opts[0] in SHARED]
    return arguments, [_record(p, ctx) for p in options if p not in shared], [_record(p, ctx) for p in shared]


def _record(parameter: Parameter, ctx: Context) -> tuple[str, str]:
    return parameter.get_help_record(ctx) or ("", "")


def about(name: str) -> tuple[str, str]:
    """(what a command does, an example line), from its docstring, whose last paragraph is "Example: rorg ..."."""
    text, _, example = inspect.cleandoc(command_of(name).__doc__ or "").partition("\n\nExample: ")
    return text, " ".join(example.split())


@cache
def typer_command(name: str) -> Command:
    """A command, by its name or an alias."""
    text, example = about(name)
    one = typer.Typer(**APP)
    declare = one.command(name, cls=Command, help=text, epilog=f"Example: {example}", context_settings=SETTINGS)
    declare(with_shared_options(command_of(name)))
    command = get_command(one)
    assert isinstance(command, Command)
    return command


_app = typer.Typer(**APP, cls=Commands, context_settings=SETTINGS, subcommand_metavar="COMMAND", help=ABOUT)


def _print_version(asked: bool) -> None:
    if asked:
        from rorg import __version__

        print(f"rorg {__version__}")
        raise typer.Exit


@_app.callback(invoke_without_command=True)
def _rorg(
    ctx: typer.Context,
    _version: Annotated[
        bool, typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    if ctx.invoked_subcommand is None:
        print(ctx.get_help())


RORG = get_command(_app)
"""The command `rorg`."""
