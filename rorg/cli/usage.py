"""Errors in command lines, each in one line with a remedy. Suggestions are safe: a command that changes something is
only suggested, with its purpose, if nothing else can be meant."""

from __future__ import annotations

import re
from collections.abc import Sequence

from rorg.cli.commands import ALIASES, COMMANDS, command_of
from rorg.cli.options import Option
from rorg.cli.signature import Parameter
from rorg.cli.terminal import printable
from rorg.errors import Invalid

HELP = "`rorg --help`"
LOOKING = frozenset(
    ("validate", "doctor", "diff", "get", "describe", "why", "events", "top", "logs", "graph", "ps", "ls", "status")
)
"""Commands that change nothing and may be suggested freely."""
REMOVE = "`rorg release NAME` to end a request; rorg removes what no manifest declares"
RESUME = "`rorg request NAME` for a service, `rorg hold NAME --end` or `rorg suspend --end`"
KNOWN = {
    **dict.fromkeys(("delete", "rm", "remove", "uninstall"), REMOVE),
    **dict.fromkeys(("resume", "unpause", "continue", "unhold", "unsuspend"), RESUME),
    **dict.fromkeys(("pause", "kill", "disable"), "`rorg hold NAME --for 10m` to keep a service from running"),
    **dict.fromkeys(("create", "new", "enable"), "`rorg init DIR` for a robot, `rorg request NAME` for a service"),
    **dict.fromkeys(("list", "services", "show"), "`rorg get`"),
    **dict.fromkeys(("inspect", "info"), "`rorg describe NAME`"),
    **dict.fromkeys(("log", "journal", "tail"), "`rorg logs NAME`, or `rorg events` for what rorg does"),
    **dict.fromkeys(("ssh", "attach", "bash", "sh"), "`rorg shell NAME`"),
    **dict.fromkeys(("check", "lint", "config"), "`rorg validate`"),
    **dict.fromkeys(("plan",), "`rorg diff`"),
    **dict.fromkeys(("undo", "revert"), "`rorg rollback`, which shows what it would do before it asks"),
}
"""Words of other programs, and what to use here."""


def unknown(word: str) -> Invalid:
    """The error for a line that begins with neither a command nor an option of `rorg` itself."""
    if word.startswith("-"):
        remedy = "it after the name of a command, as in `rorg get --help`"
        return Invalid("run `rorg`", f"unknown option {printable(word)}", remedy)
    return Invalid(f"run `rorg {printable(word)}`", "no such command", suggestion(word))


def suggestion(word: str) -> str:
    """The remedy for an unknown command."""
    if word in KNOWN:
        return KNOWN[word]
    names = (*COMMANDS, *ALIASES)
    near = [n for n in names if len(word) > 1 and n.startswith(word)] or [n for n in names if one_slip(word, n)]
    safe = [n for n in near if n in LOOKING] or ([] if near else _alike(word))
    if safe:
        return f"`rorg {safe[0]}`"
    return f"`rorg {near[0]}` ({_purpose(near[0])})" if len(near) == 1 else HELP


def _alike(word: str) -> list[str]:
    import difflib

    return difflib.get_close_matches(word, sorted(LOOKING), n=1, cutoff=0.6)


def _purpose(name: str) -> str:
    """The purpose of a command: the first sentence of its help."""
    text = (command_of(name).__doc__ or "").strip()
    first = re.split(r"[.;:,](?:\s|$)", text, maxsplit=1)[0]
    return first[:1].lower() + first[1:]


def one_slip(word: str, name: str) -> bool:
    """Whether two words differ by one letter: changed, missing, added, or two swapped."""
    if abs(len(word) - len(name)) > 1:
        return False
    begin = next((i for i, (a, b) in enumerate(zip(word, name, strict=False)) if a != b), min(len(word), len(name)))
    left, right = word[begin:], name[begin:]
    return (
        left[1:] == right[1:]
        or left[1:] == right
        or left == right[1:]
        or (left[:2] == right[1::-1] and left[2:] == right[2:])
    )


def misread(name: str, why: str, remedy: str = "") -> Invalid:
    """The error for a line that cannot be read. `name`: of the command."""
    return Invalid(f"run `rorg {name}`", printable(why), remedy or f"`rorg {name} --help`")


def unknown_option(name: str, option: str, declared: Sequence[Parameter]) -> Invalid:
    """The error for an unknown option."""
    import difflib

    known = ["--help", *(n for p in declared if isinstance(p.declared, Option) for n in p.declared.names)]
    close = [n for n in known if len(option) > 3 and n.startswith(option)]
    close += difflib.get_close_matches(option, known, n=1, cutoff=0.7)
    runs = any(p.name == "command" for p in declared)
    own = f"`rorg {name} SERVICE -- COMMAND` if it belongs to the command" if runs else ""
    return misread(name, f"unknown option {option}", close[0] if close else own)
