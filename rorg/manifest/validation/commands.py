"""Commands as they are written: what only a shell understands, and what a shell does with it."""

from __future__ import annotations

import re
from collections.abc import Iterator

from rorg.manifest.validation.finding import Finding
from rorg.manifest.validation.robot import Robot
from rorg.manifest.validation.subject import SHELLS

OPERATORS = ("&&", "||", ";", "|", ">", ">>", "2>&1", "<", "&")
EXPANDED = re.compile(r"(?<!\$)\$(\(|\{?[A-Za-z_]\w*)|`")
"""What a shell puts something else in the place of."""
BEHIND = re.compile(r"(?<![&>|<])&(?![&>0-9])")
"""What begins a program beside the shell."""


def _words(robot: Robot) -> Iterator[Finding]:
    for subject in robot.subjects:
        command = subject.options.get("command")
        words = tuple(map(str, command)) if isinstance(command, list | tuple) else ()
        if not words or any(w.rpartition("/")[2] in SHELLS for w in subject.words):
            continue
        found = _for_a_shell(words)
        if found:
            message = f"no shell runs this command, and '{found}' is handed to the program as it is"
            yield Finding("shell-words-without-shell", subject.command(), message)
        elif "sudo" in words and "no-new-privileges:true" in (subject.options.get("security_opt") or ()):
            message = "sudo gains nothing under no-new-privileges"
            yield Finding("sudo-without-privileges", subject.command(), message)


def _for_a_shell(words: tuple[str, ...]) -> str:
    """The first word that means something to a shell alone. Behind `-c` and the like stands the text of another
    program."""
    if words[0] in ("source", "."):
        return words[0]
    found = next((w for w in words if w in OPERATORS), "")
    if found:
        return found
    text = next((n for n, w in enumerate(words) if w in ("-c", "-e", "--eval")), len(words))
    return next((w for w in words[:text] if EXPANDED.search(w)), "")


def _beside(robot: Robot) -> Iterator[Finding]:
    """Programs beside the one that the container ends with."""
    for subject in (s for s in robot.subjects if s.script and s.service.restart != "never"):
        text = re.sub(r"'[^']*'|\"[^\"]*\"", "", subject.script)
        if BEHIND.search(text.rstrip()) and not re.search(r"\bwait -n\b|\btrap\b", text):
            message = f"'{subject.name}' begins a program in the background: nobody sees how that ends"
            yield Finding("program-in-background", subject.command(), message)


CHECKS = (_words, _beside)
