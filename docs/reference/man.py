"""Prints the manual page rorg(1), generated from the commands: `python docs/reference/man.py > rorg.1`."""

from __future__ import annotations

import inspect
import re
from typing import Any

import typer.main
from generate import exit_meanings

from rorg import __version__
from rorg.cli.main import app

FILES = {
    "/opt/robot/manifests": "The manifests of this robot, if rorg is a service of the machine.",
    "/run/rorg/rorg.sock": "The socket of the running rorg, for root and the group rorg.",
    "/var/lib/rorg": "The state of root's rorg; that of other users is in ~/.local/state/rorg.",
}


def plain(text: str) -> str:
    """Escapes text for roff: no requests at the start of lines, no escapes, and hyphens that can be copied."""
    text = text.replace("\\", "\\e").replace("-", "\\-")
    return re.sub(r"^(?=[.'])", r"\\&", text, flags=re.MULTILINE)


def section(title: str, *lines: str) -> list[str]:
    return [f".SH {title}", *lines]


def paragraphs(text: str) -> list[str]:
    return ["\n.PP\n".join(plain(part) for part in inspect.cleandoc(text).split("\n\n"))]


def entry(term: str, meaning: str) -> list[str]:
    """A term, with its meaning indented below."""
    return [".TP", f".B {plain(term)}", plain(meaning) or "\\&"]


def words(parameter: Any) -> str:
    """A parameter as users type it."""
    if parameter.param_type_name == "argument":
        return str(parameter.name).upper()
    return ", ".join((*parameter.opts, *parameter.secondary_opts))


def usage(name: str, arguments: list[Any]) -> str:
    """The usage line of a command."""
    typed = [words(a) + ("..." if a.nargs < 0 else "") for a in arguments]
    shown = [word if a.required else f"[{word}]" for a, word in zip(arguments, typed, strict=True)]
    return " ".join([f"rorg {name}", "[OPTIONS]", *shown])


def command(name: str, declared: Any) -> list[str]:
    """One command: usage, description, arguments and options."""
    arguments = [p for p in declared.params if p.param_type_name == "argument"]
    options = [p for p in declared.params if p.param_type_name == "option"]
    lines = [f".SS {plain(usage(name, arguments))}", *paragraphs(declared.help or "")]
    for parameter in (*arguments, *options):
        lines += entry(words(parameter), getattr(parameter, "help", "") or "")
    return lines


def page() -> str:
    """The whole page rorg(1)."""
    group: Any = typer.main.get_command(app)
    commands = [(name, declared) for name, declared in group.commands.items() if not declared.hidden]
    summary, _, more = str(group.help).partition(":")
    variables = {p.envvar: p.help for _, c in commands for p in c.params if isinstance(p.envvar, str)}
    lines = [f'.TH RORG 1 "" "rorg {plain(__version__)}" "User Commands"']
    lines += section("NAME", f"rorg \\- {plain(summary[0].lower() + summary[1:])}")
    lines += section("SYNOPSIS", ".B rorg", plain("COMMAND [OPTIONS] [ARGUMENTS]"))
    lines += section("DESCRIPTION", plain(f"{summary}:{more}"))
    lines += section("COMMANDS", *(line for name, declared in commands for line in command(name, declared)))
    lines += section("EXIT STATUS", *(line for code, text in exit_meanings() for line in entry(str(code), text)))
    lines += section("ENVIRONMENT", *(line for name in sorted(variables) for line in entry(name, variables[name])))
    lines += section("FILES", *(line for path, meaning in FILES.items() for line in entry(path, meaning)))
    lines += section("SEE ALSO", ".BR docker (1),", ".BR systemctl (1),", ".BR git (1)")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(page(), end="")
