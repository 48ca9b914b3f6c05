"""Prints the manual page rorg(1), generated from the commands: `python docs/reference/man.py > rorg.1`."""

from __future__ import annotations

import inspect
import re

from generate import exit_meanings

from rorg import __version__
from rorg.cli.app import ABOUT, about, argument_name, typer_command, usage
from rorg.cli.commands import COMMANDS
from rorg.cli.options import SHARED

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


def command(name: str) -> list[str]:
    """One command: usage, description, arguments and options."""
    declared = typer_command(name)
    typed = " ".join([f"rorg {name} [OPTIONS]", *map(usage, declared.arguments)])
    lines = [f".SS {plain(typed)}", *paragraphs(about(name)[0])]
    for argument in declared.arguments:
        lines += entry(argument_name(argument), argument.help)
    for option in (p for p in declared.params if p not in declared.arguments and p.opts[0] not in SHARED):
        lines += entry(", ".join(option.opts), option.help)
    return lines


def page() -> str:
    """The whole page rorg(1)."""
    summary, _, more = ABOUT.partition(":")
    parameters = [p for name in COMMANDS for p in typer_command(name).params]
    variables = {p.envvar: p.help for p in parameters if p.envvar}
    shared = [p for p in typer_command("get").params if p.opts[0] in SHARED]
    lines = [f'.TH RORG 1 "" "rorg {plain(__version__)}" "User Commands"']
    lines += section("NAME", f"rorg \\- {plain(summary[0].lower() + summary[1:])}")
    lines += section("SYNOPSIS", ".B rorg", plain("COMMAND [OPTIONS] [ARGUMENTS]"))
    lines += section("DESCRIPTION", plain(f"{summary}:{more}"))
    lines += section("OPTIONS", plain("Most commands have these options:"))
    lines += [line for p in shared for line in entry(", ".join(p.opts), p.help)]
    lines += section("COMMANDS", *(line for name in COMMANDS for line in command(name)))
    lines += section("EXIT STATUS", *(line for code, text in exit_meanings() for line in entry(str(code), text)))
    lines += section("ENVIRONMENT", *(line for name in sorted(variables) for line in entry(name, variables[name])))
    lines += section("FILES", *(line for path, meaning in FILES.items() for line in entry(path, meaning)))
    lines += section("SEE ALSO", ".BR docker (1),", ".BR systemctl (1),", ".BR git (1)")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    print(page(), end="")
