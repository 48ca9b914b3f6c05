"""Mistakes in command lines, each in one line with a remedy. Suggestions are safe: a command that changes something is
only suggested, with its purpose, if nothing else can be meant."""

from __future__ import annotations

from difflib import get_close_matches
from typing import Any

from typer._click.exceptions import NoSuchOption, UsageError

from rorg.cli.commands import ALIASES, COMMANDS, SUMMARIES
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
    return get_close_matches(word, sorted(LOOKING), n=1, cutoff=0.6)


def _purpose(name: str) -> str:
    summary = SUMMARIES[ALIASES.get(name, name)].rstrip(".")
    return summary[:1].lower() + summary[1:]


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


def misread(error: UsageError) -> Invalid:
    """The error for a line that typer cannot read: its own sentence, on one line, with a remedy."""
    ctx = error.ctx
    if ctx is None or ctx.parent is None:
        return unknown(getattr(error, "option_name", "-"))
    name = ctx.info_name
    remedy = _option_remedy(name, error.option_name, ctx.command) if isinstance(error, NoSuchOption) else ""
    text = error.message if remedy else error.format_message()
    return Invalid(
        f"run `rorg {name}`", printable(text[:1].lower() + text[1:].rstrip(".")), remedy or f"`rorg {name} --help`"
    )


def _option_remedy(name: str | None, option: str, command: Any) -> str:
    """What to use instead of an unknown option; empty if nothing is close."""
    known = ["--help", *(n for p in command.params for n in p.opts if n.startswith("-"))]
    close = [n for n in known if len(option) > 3 and n.startswith(option)]
    close += get_close_matches(option, known, n=1, cutoff=0.7)
    runs = any(p.name == "command" for p in command.params)
    own = f"`rorg {name} SERVICE -- COMMAND` if it belongs to the command" if runs else ""
    return close[0] if close else own
