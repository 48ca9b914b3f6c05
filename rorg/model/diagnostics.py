"""What is wrong with a manifest, and where."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True, order=True)
class Where:
    """A place in a file; line and column count from 1."""

    file: str
    line: int = 1
    column: int = 1

    def __str__(self) -> str:
        return f"{self.file}:{self.line}:{self.column}"


@dataclass(frozen=True, slots=True, order=True)
class Diagnostic:
    """One finding: an error refuses the whole tree, a warning lets it pass."""

    where: Where
    message: str
    remedy: str = ""
    severity: str = "error"
    code: str = ""
    """What is found, in short words that stay: docs/reference/findings.md has a section of each. Empty for a mistake of
    form, which says all there is to say."""

    def on(self, robot: str) -> Diagnostic:
        """The same, found for one robot of a fleet."""
        return replace(self, message=f"{self.message} (on {robot})")

    def __str__(self) -> str:
        """One line, whatever of a file is cited in it."""
        tail = f"; try {self.remedy}" if self.remedy else ""
        code = f" [{self.code}]" if self.code else ""
        return f"{self.where}: {self.severity}: {self.message}{tail}{code}".replace("\n", "\\n")

    def as_json(self) -> dict[str, str | int]:
        return {
            "file": self.where.file,
            "line": self.where.line,
            "column": self.where.column,
            "severity": self.severity,
            "message": self.message,
            "remedy": self.remedy,
            "code": self.code,
        }


def nearest(name: str, known: Iterable[str]) -> str:
    """A remedy that names the closest known name, or the known ones where none is close."""
    names = sorted(known)
    close = difflib.get_close_matches(name, names, n=1, cutoff=0.6)
    if close:
        return f"'{close[0]}'"
    return f"one of {', '.join(names)}" if names and len(names) <= 12 else ""
