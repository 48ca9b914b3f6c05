"""The format of `.env` and `env_file`, as Compose reads it.

A line is `NAME=value`; `NAME: value` and `export NAME=value` are taken, too. What begins with # is a comment, also
after a value and a space. A value without quotes ends with its line, and blanks around it are dropped; one in single
quotes is taken as it stands (`\\'` is a quote); one in double quotes knows the escapes \\n \\r \\t \\a \\b \\c \\f
\\v \\" \\\\ \\$ and octal \\0NNN. Quoted values may have several lines. Variables are filled in outside of single
quotes (template.py): from `lookup` first, then from lines before. A bare NAME takes the value that `lookup` has, or
is left out. Of several lines for one name the last holds. The source is the Compose Specification ("Env_File format")
and what Docker Compose 2.26 answers.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from rorg.manifest.template import Budget, Lookup, Refused, interpolate

_BLANKS = " \t\v\f\r\x85\xa0"
_ESCAPE = re.compile(r"\\(0[0-7]{1,3}|[abfnrtv\"\\$])")
_ESCAPED = dict(zip('abfnrtv"\\$', '\a\b\f\n\r\t\v"\\', strict=False)) | {"$": "$$"}


@dataclass(frozen=True, slots=True)
class Entry:
    """One name with its value; `line` and `column` (from 1) are those of the name. `value` is None for a bare name that
    `lookup` does not know. `unset`: variables in the value that are empty because nothing sets them."""

    name: str
    value: str | None
    line: int
    column: int
    bare: bool = False
    unset: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Mistake:
    """A syntax error and its place (line and column from 1). `variable`: the missing one, if a required variable is not
    set."""

    line: int
    column: int
    message: str
    remedy: str
    variable: str = ""


def read_dotenv(
    text: str, lookup: Lookup, before: Mapping[str, str] = MappingProxyType({})
) -> tuple[list[Entry], list[Mistake]]:
    """Returns all entries in order, and all mistakes; reading continues in the line after a mistake. `before` counts as
    lines before the first."""
    reader = _Reader(text.removeprefix("\ufeff"), lookup, before)
    while reader.to_statement():
        try:
            reader.statement()
        except _Wrong as wrong:
            reader.mistakes.append(wrong.mistake)
            reader.at = reader.end_of_line(reader.at)
    return reader.entries, reader.mistakes


def values_of(entries: list[Entry]) -> dict[str, str]:
    """Returns the final values, without bare names that have none."""
    return {entry.name: entry.value for entry in entries if entry.value is not None}


class _Wrong(Exception):
    def __init__(self, mistake: Mistake) -> None:
        self.mistake = mistake


class _Reader:
    def __init__(self, text: str, lookup: Lookup, before: Mapping[str, str]) -> None:
        self.text, self.at, self.given = text, 0, lookup
        self.entries: list[Entry] = []
        self.mistakes: list[Mistake] = []
        self.before, self.budget = dict(before), Budget()
        self.line, self.line_at, self.seen = 1, 0, 0

    def lookup(self, name: str) -> str | None:
        value = self.given(name)
        return self.before.get(name) if value is None else value

    def end_of_line(self, at: int) -> int:
        end = self.text.find("\n", at)
        return len(self.text) if end < 0 else end

    def place(self, at: int) -> tuple[int, int]:
        """Line and column of an offset. Offsets are asked for in ascending order, so each line is counted only once."""
        if at >= self.seen:
            self.line += self.text.count("\n", self.seen, at)
            self.line_at = max(self.line_at, self.text.rfind("\n", self.seen, at) + 1)
            self.seen = at
            return self.line, at - self.line_at + 1
        return self.text.count("\n", 0, at) + 1, at - self.text.rfind("\n", 0, at)

    def blanks(self, at: int) -> int:
        while at < len(self.text) and self.text[at] in _BLANKS:
            at += 1
        return at

    def to_statement(self) -> bool:
        """Skips blanks, empty lines and comments; returns whether anything follows."""
        while self.at < len(self.text):
            if self.text[self.at].isspace():
                self.at += 1
            elif self.text[self.at] == "#":
                self.at = self.end_of_line(self.at)
            else:
                return True
        return False

    def wrong(self, at: int, message: str, remedy: str, variable: str = "") -> _Wrong:
        return _Wrong(Mistake(*self.place(at), message, remedy, variable))

    def statement(self) -> None:
        export = re.compile(rf"export[{_BLANKS}]+(?=[^=:\s])").match(self.text, self.at)
        begin = export.end() if export else self.at
        name, end = self.name(begin)
        line, column = self.place(begin)
        if self.text[end : end + 1] not in ("=", ":"):
            self.at = end
            value = self.given(name)
            self.entries.append(Entry(name, value, line, column, bare=True))
        else:
            value, unset = self.value(self.blanks(end + 1))
            self.entries.append(Entry(name, value, line, column, unset=unset))
        if value is not None:
            self.before[name] = value

    def name(self, begin: int) -> tuple[str, int]:
        """Returns a name and its end: at `=` or `:`, or the end of the line."""
        at = begin
        while at < len(self.text) and self.text[at] not in "=:\n":
            char = self.text[at]
            if not (char.isalnum() or char in "_.-[]" or char in _BLANKS):
                remedy = "a name of letters, digits and _, then = and the value"
                raise self.wrong(at, f"{char!r} in the name of a variable", remedy)
            at += 1
        name = self.text[begin:at].rstrip()
        if not name:
            raise self.wrong(begin, "no name before the value", "NAME=value")
        if any(blank in name for blank in _BLANKS):
            remedy = "NAME=value, one on each line; or # before a comment"
            raise self.wrong(begin, f"a blank in the name '{name}'", remedy)
        return name, at

    def value(self, begin: int) -> tuple[str, tuple[str, ...]]:
        quote = self.text[begin : begin + 1]
        if quote in ("'", '"'):
            value, self.at = self.quoted(begin, quote)
            return (value, ()) if quote == "'" else self.filled(_unescaped(value), begin)
        end = self.end_of_line(begin)
        self.at = end
        return self.filled(self.text[begin:end].partition(" #")[0].rstrip(), begin)

    def quoted(self, begin: int, quote: str) -> tuple[str, int]:
        """Returns the text between quotes, with escaped quotes resolved, and the end of it."""
        chars, at = [], begin + 1
        while at < len(self.text) and self.text[at] != quote:
            if self.text[at] == "\\" and at + 1 < len(self.text):
                at += 1
                chars.append(quote if self.text[at] == quote else "\\" + self.text[at])
            else:
                chars.append(self.text[at])
            at += 1
        if at >= len(self.text):
            raise self.wrong(begin, "a value whose quotes are not closed", f"{quote} at its end")
        return "".join(chars), at + 1

    def filled(self, value: str, begin: int) -> tuple[str, tuple[str, ...]]:
        found = interpolate(value, self.lookup, self.budget)
        if isinstance(found, Refused):
            raise self.wrong(begin, found.message, found.remedy, found.name)
        return found.text, found.unset


def _unescaped(value: str) -> str:
    """Resolves escapes except `\\$`, which interpolation must read as a dollar sign."""
    return _ESCAPE.sub(lambda m: _ESCAPED[m[1]] if m[1] in _ESCAPED else chr(int(m[1][1:] or "0", 8)), value)
