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
from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from rorg.manifest.template import Budget, Lookup, Refused, interpolate

_BLANKS = " \t\v\f\r\x85\xa0"
_BLANK = re.compile(f"[{_BLANKS}]*")
_EXPORT = re.compile(rf"(?:export[{_BLANKS}]+(?=[^=:\s]))?")
_LINE = re.compile(r"[^\n]*")
_NAME = re.compile(rf"[\w.\-\[\]{_BLANKS}]*")
_NOTHING = re.compile(r"(?:\s++|#[^\n]*+)*+")
_QUOTED = {quote: re.compile(rf"(?:{quote}(?:\\.|[^\\{quote}])*+{quote})?", re.DOTALL) for quote in "'\""}
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


@dataclass(eq=False)
class Mistake(Exception):
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
    entries, mistakes = list[Entry](), list[Mistake]()
    while reader.to_statement():
        try:
            entries.append(reader.statement())
        except Mistake as mistake:
            mistakes.append(mistake)
            reader.skip(_LINE)
    return entries, mistakes


def values_of(entries: list[Entry]) -> dict[str, str]:
    """Returns the final values, without bare names that have none."""
    return {entry.name: entry.value for entry in entries if entry.value is not None}


class _Reader:
    def __init__(self, text: str, lookup: Lookup, before: Mapping[str, str]) -> None:
        self.text, self.at, self.given = text, 0, lookup
        self.before, self.budget = dict(before), Budget()
        self.ends = [match.start() for match in re.finditer("\n", text)]

    def lookup(self, name: str) -> str | None:
        value = self.given(name)
        return self.before.get(name) if value is None else value

    def skip(self, pattern: re.Pattern[str]) -> str:
        """Goes past a pattern that matches anything, and returns what it matched."""
        start = self.at
        if match := pattern.match(self.text, start):
            self.at = match.end()
        return self.text[start : self.at]

    def place(self, at: int) -> tuple[int, int]:
        """Line and column of an offset."""
        line = bisect_left(self.ends, at)
        return line + 1, at - (self.ends[line - 1] if line else -1)

    def to_statement(self) -> bool:
        """Skips blanks, empty lines and comments; returns whether anything follows."""
        self.skip(_NOTHING)
        return self.at < len(self.text)

    def wrong(self, at: int, message: str, remedy: str, variable: str = "") -> Mistake:
        return Mistake(*self.place(at), message, remedy, variable)

    def statement(self) -> Entry:
        self.skip(_EXPORT)
        line, column = self.place(self.at)
        name = self.name()
        if bare := self.text[self.at : self.at + 1] not in ("=", ":"):
            value, unset = self.given(name), tuple[str, ...]()
        else:
            self.at += 1
            self.skip(_BLANK)
            value, unset = self.value()
        if value is not None:
            self.before[name] = value
        return Entry(name, value, line, column, bare, unset)

    def name(self) -> str:
        """Returns a name and goes to its end: at `=` or `:`, or the end of the line."""
        begin, name = self.at, self.skip(_NAME).rstrip()
        if (char := self.text[self.at : self.at + 1]) not in ("=", ":", "\n", ""):
            remedy = "a name of letters, digits and _, then = and the value"
            raise self.wrong(self.at, f"{char!r} in the name of a variable", remedy)
        if not name:
            raise self.wrong(begin, "no name before the value", "NAME=value")
        if any(blank in name for blank in _BLANKS):
            remedy = "NAME=value, one on each line; or # before a comment"
            raise self.wrong(begin, f"a blank in the name '{name}'", remedy)
        return name

    def value(self) -> tuple[str, tuple[str, ...]]:
        begin, quote = self.at, self.text[self.at : self.at + 1]
        if quote not in _QUOTED:
            return self.filled(self.skip(_LINE).partition(" #")[0].rstrip(), begin)
        quoted = self.skip(_QUOTED[quote])
        if not quoted:
            raise self.wrong(begin, "a value whose quotes are not closed", f"{quote} at its end")
        value = quoted[1:-1].replace(f"\\{quote}", quote)
        return (value, ()) if quote == "'" else self.filled(_unescaped(value), begin)

    def filled(self, value: str, begin: int) -> tuple[str, tuple[str, ...]]:
        try:
            filled = interpolate(value, self.lookup, self.budget)
        except Refused as why:
            raise self.wrong(begin, why.message, why.remedy, why.name) from None
        return filled.text, filled.unset


def _unescaped(value: str) -> str:
    """Resolves escapes except `\\$`, which interpolation must read as a dollar sign."""
    return _ESCAPE.sub(lambda m: _ESCAPED[m[1]] if m[1] in _ESCAPED else chr(int(m[1][1:] or "0", 8)), value)
