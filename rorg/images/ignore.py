"""What a .dockerignore leaves out: patterns as Docker reads them (moby's patternmatcher)."""

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
    """One line. Raises ValueError for one that Docker refuses."""

    def __init__(self, line: str) -> None:
        self.exception = line.startswith("!")
        text = line[1:].strip() if self.exception else line
        if not text:
            raise ValueError("'!' alone excepts nothing")
        text = posixpath.normpath(text)
        self.text = text.lstrip("/") if len(text) > 1 else text
        try:
            self._whole = compiled(_expression(self.text))
            self._parts = [None if "**" in p else compiled(_expression(p)) for p in self.text.split("/")]
        except ValueError as error:
            raise ValueError(f"'{line}' is no pattern: {error}") from error

    def matches(self, parts: Sequence[str]) -> bool:
        """Whether it means a path, or a directory above it."""
        return any(self._whole.fullmatch(_text("/".join(parts[:end]))) for end in range(len(parts), 0, -1))

    def reaches_below(self, parts: Sequence[str]) -> bool:
        """Whether it may mean something within a directory."""
        for part, pattern in zip(parts, self._parts, strict=False):
            if pattern is None:
                return True
            if not pattern.fullmatch(_text(part)):
                return False
        return True


def _text(path: str) -> str:
    """A path in characters; a name may have bytes that are none."""
    return path.encode("utf-8", "surrogateescape").decode("utf-8", "replace")


def _expression(pattern: str) -> str:
    """`*` and `?` stop at a slash, `**` does not; what is in brackets, and after a backslash, is as Go has it. RE2,
    which is Go's own, takes no pattern a long time."""
    return "(?s)" + "".join(_pieces(pattern))


def _pieces(pattern: str) -> Iterator[str]:
    for found in re.finditer(r"(\*\*/?)|\\(.)|([*?])|(\[(?:\\.|[^\]\\])*\]?)|(.)", pattern, re.DOTALL):
        stars, escaped, wild, brackets, other = found.groups()
        if stars:
            yield ".*" if found.end() == len(pattern) else "(.*/)?"
        elif wild:
            yield "[^/]*" if wild == "*" else "[^/]"
        elif brackets:
            yield brackets
        else:
            yield re.escape(escaped or other)


class Ignore:
    """All lines; of several that mean a path the last one counts."""

    def __init__(self, lines: Sequence[str]) -> None:
        self._patterns = [Pattern(line) for line in lines]
        self._exceptions = [p for p in self._patterns if p.exception]

    def leaves_out(self, parts: Sequence[str]) -> bool:
        """A path, by its parts."""
        out = False
        for pattern in self._patterns:
            if pattern.exception == out and pattern.matches(parts):
                out = not out
        return out

    def leaves_out_all_of(self, parts: Sequence[str]) -> bool:
        """A directory that is left out, and no exception reaches into it."""
        return self.leaves_out(parts) and not any(p.reaches_below(parts) for p in self._exceptions)


def read_ignore(context: Path, dockerfile: str) -> Ignore:
    """That of a context: `DOCKERFILE.dockerignore` where there is one, else `.dockerignore`, as BuildKit has it.
    Raises OSError, whose `strerror` says why, for one that cannot be read or has a bad line."""
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
