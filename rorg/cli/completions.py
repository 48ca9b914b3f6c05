"""What a shell offers after TAB: commands and options from their declarations, names from the running rorg or from a
quick look at the manifests. The shell scripts are in completion.py."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from rorg.cli.commands import ALIASES, COMMANDS, command_of
from rorg.cli.context import Context
from rorg.cli.options import DIRECTORIES, FILES, KINDS, NAMES_OF_KIND, Argument, Option
from rorg.cli.signature import Parameter, parameters

PATIENCE = 1.0
"""Longest time, in seconds, that a shell waits for names."""
BREAKS = ("=", ":")
"""Characters that are words of their own to bash."""
MOST = 1 << 16
"""Characters of a manifest that are read."""
NAME = re.compile(
    r"""^metadata:\s*(?:\{[^}\n]*?|(?:.*\n\s+)*?)\bname:\s*["']?([\w.-]+(?:[/:][\w.-]+)*)""", re.MULTILINE
)
SEPARATOR = re.compile(r"^---(?=\s)", re.MULTILINE)
KIND = re.compile(r"^kind:\s*(\w+)", re.MULTILINE)


class Given(NamedTuple):
    """The words before the unfinished one."""

    arguments: list[str]
    options: dict[str, str]
    """By the name of the parameter; the text of a flag is empty."""
    awaited: Parameter | None
    """The option whose value is unfinished."""


def answer(shell: str, words: Sequence[str]) -> str:
    """The completions of the last word after `rorg`, in lines as the shell's script expects them."""
    typed = words[-1] if words else ""
    words = _joined(words) if shell == "bash" else list(words) or [""]
    begun = words[-1]
    cut = len(begun.removesuffix(typed if typed not in BREAKS else "")) if shell == "bash" else 0
    prefix, offered = "", {n: "" for n in COMMANDS} if not begun.startswith("-") else {"--help": "", "--version": ""}
    if len(words) > 1:
        if words[0] not in (*COMMANDS, *ALIASES):
            return ""
        prefix, offered = after(parameters(command_of(words[0])), words[1:])
    begun = begun[len(prefix) :]
    completions = {(prefix + word)[cut:]: about for word, about in offered.items() if word.startswith(begun)}
    completions |= {word: about for word, about in offered.items() if word in (FILES, DIRECTORIES)}
    return "\n".join(_line(shell, word, about) for word, about in completions.items() if word.isprintable())


def _joined(words: Sequence[str]) -> list[str]:
    """The words as typed: bash splits --output=json into three words, and base:1.2 too."""
    whole_words: list[str] = []
    glue = False
    for word in words:
        sign = bool(whole_words) and (word == ":" or (word == "=" and whole_words[-1].startswith("--")))
        if sign or glue:
            whole_words[-1] += word
        else:
            whole_words.append(word)
        glue = sign
    return whole_words or [""]


def _line(shell: str, word: str, about: str) -> str:
    if word.startswith(":") or shell == "bash" or not about:
        return word.replace(":", "\\:") if shell == "zsh" and not word.startswith(":") else word
    text = " ".join(about.split())
    return f"{word}\t{text}" if shell == "fish" else word.replace(":", "\\:") + ":" + text


def after(taken: Sequence[Parameter], words: Sequence[str]) -> tuple[str, dict[str, str]]:
    """For a command with these parameters: (the part of the unfinished word to keep, completion -> its help)."""
    options = {n: p for p in taken if isinstance(p.declared, Option) for n in p.declared.names}
    begun, given = words[-1], _given(options, words[:-1])
    name, equals, _ = begun.partition("=")
    if given.awaited:
        return "", _values(given.awaited, given)
    if equals and name in options:
        return name + equals, _values(options[name], given)
    if begun.startswith("-"):
        free = {n: p for n, p in options.items() if p.many or p.name not in given.options}
        return "", {**{n: p.declared.help for n, p in free.items()}, "--help": "Show help and exit."}
    arguments = [p for p in taken if isinstance(p.declared, Argument) and not p.rest]
    at = len(given.arguments)
    if at >= len(arguments) and not (arguments and arguments[-1].many):
        return "", {}
    argument = arguments[min(at, len(arguments) - 1)]
    named = given.arguments if argument.many else ()
    return "", {word: about for word, about in _values(argument, given).items() if word not in named}


def _given(options: dict[str, Parameter], words: Sequence[str]) -> Given:
    given = Given([], {}, None)
    awaited: Parameter | None = None
    for word in words:
        name, equals, value = word.partition("=")
        option = options.get(name)
        if awaited:
            given.options[awaited.name], awaited = word, None
        elif option:
            given.options[option.name] = value
            awaited = option if option.takes_next and not equals else None
        elif not word.startswith("-"):
            given.arguments.append(word)
    return given._replace(awaited=awaited)


def _values(parameter: Parameter, given: Given) -> dict[str, str]:
    """The completions that a parameter declares."""
    completes = parameter.declared.choices or parameter.declared.completes
    if not isinstance(completes, str):
        return dict.fromkeys(completes, "")
    if completes in (FILES, DIRECTORIES):
        return {completes: ""}
    kind = given.arguments[0] if completes == NAMES_OF_KIND and given.arguments else completes
    return dict.fromkeys(_names(kind, given), "")


def _names(kind: str, given: Given) -> Iterable[str]:
    """The names of a kind; none if anything goes wrong, because a shell asks."""
    try:
        state, tree = given.options.get("state_dir"), given.options.get("directory")
        context = Context(Path(state) if state else None, None, Path(tree) if tree else None)
        context.notices.quiet = True
        one = next((k for k, words in KINDS.items() if kind in words), "")
        return (_served if context.client() else _glanced)(context, one) if one else ()
    except Exception:
        return ()


def _served(context: Context, kind: str) -> list[str]:
    client = context.serving("complete")
    client.timeout, client.patience = PATIENCE, 0.0
    if kind == "request":
        return [r["id"] for r in client.requests() if not r["standing"]]
    if kind == "service":
        return [s["service"] for s in client.services()] + [g["name"] for g in client.groups()]
    if kind == "group":
        return [g["name"] for g in client.groups()]
    return [m["name"] for m in client.manifests() if m["kind"].lower() == kind]


def _glanced(context: Context, kind: str) -> list[str]:
    if kind == "request":
        return [r.id for r in context.document().requests]
    return declared(context.root, ("service", "group") if kind == "service" else (kind,))


def declared(root: Path, kinds: Sequence[str]) -> list[str]:
    """Names in the manifests, by a quick look: a shell should not wait until they are loaded."""
    names = ["developer"] if "service" in kinds else []
    for path in sorted((*root.glob("*.yaml"), *(p for k in kinds for p in root.glob(f"{KINDS[k][0]}/*.yaml")))):
        with path.open(encoding="utf-8", errors="replace") as file:
            text = file.read(MOST)
        for part in SEPARATOR.split(text):
            kind, name = KIND.search(part), NAME.search(part)
            if kind and name and kind[1].lower() in kinds:
                names.append(name[1])
    return names
