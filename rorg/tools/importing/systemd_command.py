"""Command lines of systemd units (systemd.service(5)), as words and as lines of a shell."""

from __future__ import annotations

import shlex
from dataclasses import dataclass


@dataclass(frozen=True)
class Line:
    """One command line."""

    prefixes: str
    """Signs that tell systemd how to run it: - ignores a failure, + and ! run it as root, @ gives it another name, and
    : fills in no variables."""
    text: str

    @classmethod
    def of(cls, value: str) -> Line:
        """The line of a setting such as ExecStart."""
        text = value.lstrip("-@:+!|")
        prefixes = value[: len(value) - len(text)]
        program, _, rest = text.strip().partition(" ")
        if "@" in prefixes:  # the second word is argv[0]
            rest = rest.strip().partition(" ")[2]
        return cls(prefixes, f"{program} {rest.strip()}".strip())

    @property
    def has_variables(self) -> bool:
        return "$" in self.text and ":" not in self.prefixes


def words_of(line: Line) -> list[str]:
    """The words of a line without variables. Raises ValueError for an unclosed quote."""
    return shlex.split(line.text)


def shell_line(before: list[Line], starts: list[Line]) -> str:
    """A line for a shell: one command after the other, and the last in its place. Raises ValueError for an unclosed
    quote."""
    first, last = [*before, *starts[:-1]], starts[-1:]
    lines = [f"{{ {_of_shell(line)} || true; }}" if "-" in line.prefixes else _of_shell(line) for line in first]
    return " && ".join([*lines, *(f"exec {_of_shell(line)}" for line in last)])


def _of_shell(line: Line) -> str:
    if ":" in line.prefixes:
        return shlex.join(words_of(line))
    shlex.split(line.text)
    return line.text.replace("$$", "\\$")
