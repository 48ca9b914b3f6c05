"""Prints the manual page rorg(1), generated from the commands: `python docs/reference/man.py > rorg.1`."""

from __future__ import annotations

import inspect
import re

from generate import exit_meanings

from rorg import __version__
from rorg.cli.commands import COMMANDS, command_of
from rorg.cli.help import ABOUT, about, usage
from rorg.cli.options import Argument, Option
from rorg.cli.signature import Parameter, parameters

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


def words(parameter: Parameter) -> str:
    """A parameter as users type it."""
    return ", ".join(parameter.declared.names) if isinstance(parameter.declared, Option) else parameter.name.upper()


def command(name: str) -> list[str]:
    """One command: usage, description, arguments and options."""
    declared = [p for p in parameters(command_of(name)) if not p.rest]
    arguments = [p for p in declared if isinstance(p.declared, Argument)]
    typed = " ".join([f"rorg {name} [OPTIONS]", *map(usage, arguments)])
    lines = [f".SS {plain(typed)}", *paragraphs(about(command_of(name))[0])]
    for parameter in (*arguments, *(p for p in declared if p not in arguments)):
        lines += entry(words(parameter), parameter.declared.help)
    return lines


def page() -> str:
    """The whole page rorg(1)."""
    summary, _, more = ABOUT.partition(":")
    options = [p.declared for name in COMMANDS for p in parameters(command_of(name)) if isinstance(p.declared, Option)]
    variables = {option.envvar: option.help for option in options if option.envvar}
    lines = [f'.TH RORG 1 "" "rorg {plain(__version__)}" "User Commands"']
    lines += section("NAME", f"rorg \\- {plain(summary[0].lower() + summary[1:])}")
    lines += section("SYNOPSIS", ".B rorg", plain("COMMAND [OPTIONS] [ARGUMENTS]"))
    lines += section("DESCRIPTION", plain(f"{summary}:{more}"))
    lines += section("COMMANDS", *(line for name in COMMANDS for line in command(name)))
    lines += section("EXIT STATUS", *(line for code, text in exit_meanings() for line in entry(str(code), text)))
    lines += section("ENVIRONMENT", *(line for name in sorted(variables) for line in entry(name, variables[name])))
    lines += section("FILES", *(line for path, meaning in FILES.items() for line in entry(path, meaning)))
    lines += section("SEE ALSO", ".BR docker (1),", ".BR systemctl (1),", ".BR git (1)")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(page(), end="")
