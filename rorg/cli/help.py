"""The help of rorg and of its commands, made of their declarations and docstrings."""

from __future__ import annotations

import inspect
import shutil
import textwrap
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from rorg.cli.commands import ALIASES, COMMANDS, command_of
from rorg.cli.options import Argument, Option, duration, moment
from rorg.cli.signature import Parameter, parameters

ABOUT = "Run a robot's services: declared in YAML, started and ceased by requests."
EXITS = (
    "Exit codes: 0 ok, 1 differences (diff) or still wanted (stop), 2 usage or invalid manifest, 3 engine or daemon "
    "unreachable, 4 applied but not ready, 5 refused, 70 internal error."
)
HELP = ("-h, --help", "Show this help.")
VALUES = {duration: "DURATION", moment: "TIME", str: "TEXT", int: "N", float: "NUMBER", Path: "PATH"}
WIDEST = 100
"""Columns of the help at most: longer lines are hard to read."""


def about(command: Callable[..., Any]) -> tuple[str, str]:
    """(what a command does, an example line), from its docstring, whose last paragraph is "Example: rorg ..."."""
    text, _, example = inspect.cleandoc(command.__doc__ or "").partition("\n\nExample: ")
    return text, " ".join(example.split())


def help_of_rorg() -> str:
    """The help of `rorg` itself: all commands."""
    first = [(name, about(command_of(name))[0].partition(".")[0].replace("\n", " ") + ".") for name in COMMANDS]
    aliases = "Aliases: " + "; ".join(f"{name} is {command}" for name, command in ALIASES.items()) + "."
    options = [("--version", "Print the version."), HELP]
    return _page("rorg COMMAND [OPTIONS]", ABOUT, [("Commands", first), ("Options", options)], (EXITS, aliases))


def help_of(name: str) -> str:
    """The help of a command."""
    declared = parameters(command_of(name))
    text, example = about(command_of(name))
    arguments = [(usage(p), described(p)) for p in declared if isinstance(p.declared, Argument)]
    options = [(_option(p), described(p)) for p in declared if isinstance(p.declared, Option)]
    line = " ".join([f"rorg {name} [OPTIONS]", *(usage(p) for p in declared if isinstance(p.declared, Argument))])
    return _page(line, text, [("Arguments", arguments), ("Options", [*options, HELP])], (f"Example: {example}",))


def usage(argument: Parameter) -> str:
    """An argument as written in the usage line of its command."""
    text = argument.name.upper() + ("..." if argument.many else "")
    return f"-- {text}" if argument.rest else text if argument.required else f"[{text}]"


def _option(parameter: Parameter) -> str:
    option = parameter.declared
    assert isinstance(option, Option)
    value = option.metavar or VALUES.get(option.parser) or VALUES.get(parameter.type, "TEXT")
    if option.bare:
        value = "|".join(option.choices)
        return f"{', '.join(option.names)}[={value}]"
    return ", ".join(option.names) + ("" if parameter.flag else f" {value}")


def described(parameter: Parameter) -> str:
    """The help of a parameter, with its default and its limits."""
    declared, default, facts = parameter.declared, parameter.default, []
    if declared.show_default and default not in (None, "", False, []):
        facts.append(f"default: {f'{default:g}s' if getattr(declared, 'parser', None) is duration else default}")
    if isinstance(declared, Option) and declared.least is not None:
        facts.append(
            f"from {declared.least:g} to {declared.most:g}" if declared.most else f"at least {declared.least:g}"
        )
    if isinstance(declared, Option) and declared.envvar:
        facts.append(f"or {declared.envvar}")
    return declared.help + (f"  [{'; '.join(facts)}]" if facts else "")


def _page(line: str, text: str, tables: Iterable[tuple[str, list[tuple[str, str]]]], end: Iterable[str]) -> str:
    width = min(WIDEST, shutil.get_terminal_size().columns)
    lines = [f"Usage: {line}"]
    for paragraph in text.split("\n\n"):
        lines += ["", *textwrap.wrap(paragraph, width, initial_indent="  ", subsequent_indent="  ")]
    for title, rows in tables:
        lines += ["", f"{title}:"] if rows else []
        column = min(max((len(name) for name, _ in rows), default=0), 28) + 4
        for name, meaning in rows:
            wrapped = textwrap.wrap(meaning, max(20, width - column)) or [""]
            lines += [f"  {name}"] if len(name) + 4 > column else []
            head = "" if len(name) + 4 > column else f"  {name}"
            lines += [f"{head:<{column}}{wrapped[0]}", *(" " * column + rest for rest in wrapped[1:])]
    for paragraph in end:
        lines += ["", *textwrap.wrap(paragraph, width, initial_indent="  ", subsequent_indent="  ")]
    return "\n".join(lines)
