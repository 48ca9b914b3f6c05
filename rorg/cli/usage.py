"""What is wrong with a command line, in one line with a remedy. What is suggested is safe: a command that changes
something is only named where nothing else can be meant, and with what it does."""

from __future__ import annotations

import re

from rorg.cli.commands import ALIASES, COMMANDS, command_of
from rorg.errors import Invalid

HELP = "`rorg --help`"
LOOKING = frozenset(
    ("validate", "doctor", "diff", "get", "describe", "why", "events", "top", "logs", "graph", "ps", "ls", "status")
)
"""Commands that change nothing: they may be guessed."""
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
    **dict.fromkeys(("version",), "`rorg --version`"),
    **dict.fromkeys(("help",), HELP),
}
"""Words of other programs, and what serves their purpose here."""


def unknown_command(word: str) -> Invalid:
    """The error for a command that there is not."""
    from rorg.cli.terminal import printable

    return Invalid(f"run `rorg {printable(word)}`", "no such command", suggestion(word))


def suggestion(word: str) -> str:
    """The remedy for a command that there is not."""
    if word in KNOWN:
        return KNOWN[word]
    names = (*COMMANDS, *ALIASES)
    near = [n for n in names if len(word) > 1 and n.startswith(word)] or [n for n in names if one_slip(word, n)]
    safe = [n for n in near if n in LOOKING] or ([] if near else _alike(word))
    if safe:
        return f"`rorg {safe[0]}`"
    return f"`rorg {near[0]}`, which is to {_purpose(near[0])}" if len(near) == 1 else HELP


def _alike(word: str) -> list[str]:
    import difflib

    return difflib.get_close_matches(word, sorted(LOOKING), n=1, cutoff=0.6)


def _purpose(name: str) -> str:
    """What a command does, by the beginning of its help."""
    text = (command_of(name).__doc__ or "").strip()
    first = re.split(r"[.;:,](?:\s|$)", text, maxsplit=1)[0]
    return first[:1].lower() + first[1:]


def one_slip(word: str, name: str) -> bool:
    """Whether they differ by one letter: another one, one more, one less, or two that have changed places."""
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


def misread(command: str, error: Exception) -> Invalid:
    """A complaint of typer's, as every other error of ours. `command`: what was run, such as `rorg get`."""
    if type(error).__name__ == "NoSuchOption":
        option = str(getattr(error, "option_name", ""))
        return Invalid(f"run `{command}`", f"unknown option {option}", _option(command, option))
    told = error.format_message() if hasattr(error, "format_message") else str(error)
    text = " ".join(told.split()).rstrip(".")
    return Invalid(f"run `{command}`", text[:1].lower() + text[1:], f"`{command} --help`")


def _option(command: str, option: str) -> str:
    """The remedy for an option that there is not."""
    import difflib

    from rorg.cli.options import Option
    from rorg.cli.signature import parameters

    word = command.removeprefix("rorg").strip()
    if not word:
        return "it after the name of a command, as in `rorg get --help`"
    declared = parameters(command_of(word))
    known = [n for p in declared if isinstance(p.declared, Option) for n in p.declared.names]
    close = difflib.get_close_matches(option, known, n=1, cutoff=0.6)
    if close:
        return close[0]
    runs = any(p.name == "command" for p in declared)
    return f"`{command} SERVICE -- COMMAND` where it is the command's" if runs else f"`{command} --help`"
