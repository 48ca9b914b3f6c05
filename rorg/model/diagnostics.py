"""Mistakes in manifests, with their places."""

from __future__ import annotations

import difflib
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import asdict, dataclass, replace
from typing import TypeVar

from rorg.errors import advice

HINT = "hint"


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
    """One mistake or finding. An error refuses the whole tree, a warning does not; a hint is shown on request."""

    where: Where
    message: str
    remedy: str = ""
    severity: str = "error"
    code: str = ""
    """The stable code of a finding; docs/reference/findings.md has a section for each. Empty for a mistake of form,
    whose message is complete."""

    def on(self, robot: str) -> Diagnostic:
        """The same diagnostic, found for one robot of a fleet."""
        return replace(self, message=f"{self.message} (on {robot})")

    def __str__(self) -> str:
        """The diagnostic on one line, even if the quoted text has several."""
        code = f" [{self.code}]" if self.code else ""
        return f"{self.where}: {self.severity}: {self.message}{advice(self.remedy)}{code}".replace("\n", "\\n")

    def as_json(self) -> dict[str, str | int]:
        names = ("severity", "message", "remedy", "code")
        return asdict(self.where) | {name: getattr(self, name) for name in names}


T = TypeVar("T")
Y = TypeVar("Y")
Reading = Generator[Diagnostic, None, T]
"""Yields what is wrong, and returns what it read."""


def collected(reading: Generator[Y, None, T]) -> tuple[T, list[Y]]:
    """Runs a reading; returns what it read, and everything that is wrong."""
    problems: list[Y] = []
    while True:
        try:
            problems.append(next(reading))
        except StopIteration as end:
            return end.value, problems


MOST_SUGGESTIONS = 100
"""Maximum number of suggestions per tree: each unknown name is compared with every known one."""
_LEFT: ContextVar[list[int] | None] = ContextVar("suggestions", default=None)


@contextmanager
def few_suggestions() -> Iterator[None]:
    """Limits suggestions while a tree is read."""
    token = _LEFT.set([MOST_SUGGESTIONS])
    try:
        yield
    finally:
        _LEFT.reset(token)


def close_to(name: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """The closest known name; empty if none is close, or if there were enough suggestions."""
    left = _LEFT.get()
    if left is not None:
        if left[0] <= 0:
            return ""
        left[0] -= 1
    return next(iter(difflib.get_close_matches(name, sorted(known), n=1, cutoff=cutoff)), "")


def nearest(name: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """A remedy that names the closest known name, or a few known names if none is close."""
    names = sorted(known)
    if close := close_to(name, names, cutoff):
        return f"'{close}'"
    return f"one of {', '.join(names)}" if names and len(names) <= 20 else ""


def unknown(where: Where, what: str, name: str, known: Iterable[str]) -> Diagnostic:
    """The error for a name that means nothing; `what` is the kind of thing that it should name."""
    return Diagnostic(where, f"unknown {what} '{name}'", nearest(name, known))
