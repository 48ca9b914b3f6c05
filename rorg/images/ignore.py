"""The patterns of a .dockerignore, interpreted as Docker does (moby's patternmatcher)."""

from __future__ import annotations

import errno
import posixpath
import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from rorg.manifest.files import read_text
from rorg.manifest.patterns import compiled

NAME = ".dockerignore"


class Pattern:
    """One line. Raises ValueError if Docker refuses it."""

    def __init__(self, line: str) -> None:
        self.exception = line.startswith("!")
        text = line[1:].strip() if self.exception else line
        if not text:
            raise ValueError("'!' without a pattern")
        text = posixpath.normpath(text)
        self.text = text.lstrip("/") if len(text) > 1 else text
        try:
            self._whole = compiled(_expression(self.text))
            self._parts = [None if "**" in p else compiled(_expression(p)) for p in self.text.split("/")]
        except ValueError as error:
            raise ValueError(f"'{line}' is not a valid pattern: {error}") from error

    def matches(self, parts: Sequence[str]) -> bool:
        """Whether it matches a path, or a directory above it."""
        return any(self._whole.fullmatch(_text("/".join(parts[:end]))) for end in range(len(parts), 0, -1))

    def reaches_below(self, parts: Sequence[str]) -> bool:
        """Whether it may match something inside a directory."""
        for part, pattern in zip(parts, self._parts, strict=False):
            if pattern is None:
                return True
            if not pattern.fullmatch(_text(part)):
                return False
        return True


def _text(path: str) -> str:
    """A path as text; bytes that are not UTF-8 are replaced."""
    return path.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def _expression(pattern: str) -> str:
    """`*` and `?` stop at a slash, `**` does not. Brackets and backslashes have Go's meaning. RE2, the engine of Go,
    has no slow patterns."""
    return "(?s)" + "".join(_pieces(pattern))


def _pieces(pattern: str) -> Iterator[str]:
    for match in re.finditer(r"(\*\*/?)|\\(.)|([*?])|(\[(?:\\.|[^\]\\])*\]?)|(.)", pattern, re.DOTALL):
        stars, escaped, wild, brackets, other = match.groups()
        if stars:
            yield ".*" if match.end() == len(pattern) else "(.*/)?"
        elif wild:
            yield "[^/]*" if wild == "*" else "[^/]"
        elif brackets:
            yield brackets
        else:
            yield re.escape(escaped or other)


class Ignore:
    """All lines. If several match a path, the last one wins."""

    def __init__(self, lines: Sequence[str]) -> None:
        self._patterns = [Pattern(line) for line in lines]
        self._exceptions = [p for p in self._patterns if p.exception]

    def leaves_out(self, parts: Sequence[str]) -> bool:
        """Whether a path, given by its parts, is left out."""
        out = False
        for pattern in self._patterns:
            if pattern.exception == out and pattern.matches(parts):
                out = not out
        return out

    def leaves_out_all_of(self, parts: Sequence[str]) -> bool:
        """Whether a directory is left out, and no exception matches inside it."""
        return self.leaves_out(parts) and not any(p.reaches_below(parts) for p in self._exceptions)


def read_ignore(context: Path, dockerfile: str) -> Ignore:
    """The patterns of a context: from `DOCKERFILE.dockerignore` if it exists, otherwise from `.dockerignore`, as in
    BuildKit. Raises OSError, whose `strerror` says why, if it cannot be read or has a bad line."""
    for path in (context / f"{dockerfile}{NAME}", context / NAME):
        try:
            text = read_text(path, context)
        except (FileNotFoundError, NotADirectoryError):
            continue
        lines = (line.strip() for line in text.removeprefix("\ufeff").splitlines() if not line.startswith("#"))
        try:
            return Ignore([line for line in lines if line])
        except ValueError as error:
            raise OSError(errno.EINVAL, str(error), str(path)) from error
    return Ignore([])
