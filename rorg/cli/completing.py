"""What a shell offers after TAB. Names of services are answered here, by the running rorg or by a glance at the
manifests; all the rest is typer's."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path
from typing import Any

from rorg.cli.commands import ALIASES, COMMANDS, command_of
from rorg.cli.options import Argument
from rorg.cli.plain import words_before
from rorg.cli.signature import parameters

PATIENCE = 1.0
"""Seconds that a shell waits for names at the most."""
NAME = re.compile(r"""^metadata:\s*(?:\{[^}\n]*?|(?:.*\n\s+)*?)\bname:\s*["']?([\w.-]+)""", re.MULTILINE)
KIND = re.compile(r"^kind:\s*(Service|Group)\b", re.MULTILINE)


def answered() -> bool:
    """Prints the names of services that may follow, as the shell takes them; False where something else may follow."""
    line = _line(os.environ)
    if line is None:
        return False
    shell, words, incomplete = line
    if (
        not words
        or words[0] not in (*COMMANDS, *ALIASES)
        or incomplete.startswith("-")
        or not _is_service(words[0], words[1:])
    ):
        return False
    found = services(incomplete)
    if shell == "zsh":
        print("_arguments '*: :((" + "\n".join(f'"{name}"' for name in found) + "))'" if found else "_files")
    elif os.environ.get("_TYPER_COMPLETE_FISH_ACTION") == "is-args":
        sys.exit(not found)  # where nothing is offered, fish offers files
    elif found:
        print("\n".join(found))
    return True


def _line(environment: Any) -> tuple[str, list[str], str] | None:
    """(shell, words after `rorg`, the word that is begun); None for lines with quotes and for other shells."""
    shell = environment["_RORG_COMPLETE"].removeprefix("complete_")
    if shell == "bash":
        text, number = environment.get("COMP_WORDS", ""), environment.get("COMP_CWORD", "")
        words = text.split()
        if not number.isdigit() or set(text) & set("\"'\\"):
            return None
        return shell, words[1 : int(number)], words[int(number)] if int(number) < len(words) else ""
    text = environment.get("_TYPER_COMPLETE_ARGS", "")
    if shell not in ("zsh", "fish") or set(text) & set("\"'\\") or not text:
        return None
    words = text.split()[1:]
    begun = words.pop() if words and not text.endswith(" ") else ""
    return shell, words, begun


def _is_service(command: str, words: list[str]) -> bool:
    """Whether the next word of a command is the name of a service."""
    declared = parameters(command_of(command))
    before = words_before(declared, words)
    if before is None:
        return False
    arguments = [(p.declared.service, p.many) for p in declared if isinstance(p.declared, Argument) and not p.rest]
    if before >= len(arguments):
        arguments = [(service, many) for service, many in arguments[-1:] if many]
        before = 0
    return any(service for service, _ in arguments[before : before + 1])


def services(incomplete: str) -> list[str]:
    """Names of services and groups that begin so. Whatever goes wrong, nothing is said: a shell asks."""
    try:
        from rorg.cli.context import Context

        context = Context(None, None)
        client = context.client()
        if client is None:
            names = _declared(context.root)
        else:
            client.timeout, client.patience = PATIENCE, 0.0
            names = [s["service"] for s in client.services()] + [g["name"] for g in client.groups()]
    except Exception:
        return []
    return [name for name in names if name.startswith(incomplete)]


def _declared(root: Path) -> list[str]:
    """Names in the manifests, by a glance: reading them whole takes longer than a shell should wait."""
    found = ["developer"]
    for path in sorted((*root.glob("*.yaml"), *root.glob("services/*.yaml"), *root.glob("groups/*.yaml"))):
        text = path.read_text(encoding="utf-8", errors="replace")
        name = NAME.search(text)
        if KIND.search(text) and name:
            found.append(name[1])
    return found
