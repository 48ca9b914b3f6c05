"""Variables in one text, as Compose fills them in.

`$NAME` and `${NAME}` are replaced by the value, `$$` by a dollar sign. An operator within braces handles unset
variables:

| form | gives |
|---|---|
| `${NAME:-text}`, `${NAME-text}` | the text if NAME is unset or empty; only if it is unset |
| `${NAME:?text}`, `${NAME?text}` | an error with the text if NAME is unset or empty; only if it is unset |
| `${NAME:+text}`, `${NAME+text}` | the text if NAME is set and not empty; if it is set; else nothing |

The text of an operator may contain variables, and ends at the closing brace. A dollar sign before anything else stays.
An unset variable without an operator is empty. Values are not expanded again. These rules come from the Compose
Specification ("Interpolation") and from the behaviour of Docker Compose 2.26.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import groupby

Lookup = Callable[[str], "str | None"]
"""Returns the value of a variable; None if it is not set."""

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_SIGN = re.compile(r"\$\$|\$\{|\$[A-Za-z_][A-Za-z0-9_]*|[{}]")
_OPERATORS = (":-", ":?", ":+", "-", "?", "+")
MOST_DEPTH = 50
"""Nesting of variables in texts of operators."""
MOST_FILLED = 256 << 10
"""Characters that variables may add to one file. Without a limit, each variable could double the text by naming another
one twice."""


@dataclass(frozen=True, slots=True)
class Variable:
    """One reference. `start` and `end` are offsets in the whole text; `argument` is the text of the operator."""

    name: str
    start: int
    end: int
    braced: bool = True
    operator: str = ""
    argument: tuple[Piece, ...] = ()


Piece = str | Variable
"""A piece of a parsed text: plain text (with `$` for `$$`), or a reference."""


@dataclass(eq=False)
class Refused(Exception):
    """Why a text cannot be filled in. `name`: the required variable that is not set; empty for a syntax error. `offset`
    counts characters from 0."""

    offset: int
    message: str
    remedy: str
    name: str = ""


@dataclass(frozen=True, slots=True)
class Filled:
    """A text with its variables filled in. `used`: all variables in it, in order; `unset`: those that became empty
    because they are not set and have no operator."""

    text: str
    used: tuple[str, ...] = ()
    unset: tuple[str, ...] = ()


class Budget:
    """Counts down how much variables may still add to one file."""

    def __init__(self) -> None:
        self.left = MOST_FILLED

    def take(self, variable: Variable, value: str) -> str:
        """Returns the value of a variable, or raises if it is too long."""
        self.left -= len(value)
        if self.left < 0:
            message = (
                f"variables put more than {MOST_FILLED} characters into this file, the last of them {variable.name}"
            )
            raise Refused(variable.start, message, f"a shorter value of {variable.name}")
        return value


def parse(text: str) -> tuple[Piece, ...]:
    """The pieces of a text. Raises Refused."""
    return _Parser(text).pieces(0, 0)[0]


def interpolate(text: str, lookup: Lookup, budget: Budget | None = None) -> Filled:
    """Fills in the variables of a text. Texts of one file share a `budget`. Raises Refused for the first error."""
    if "$" not in text:
        return Filled(text)
    pieces = parse(text)
    used, unset = dict.fromkeys(v.name for v in variables(pieces)), dict[str, None]()
    return Filled(_fill(pieces, lookup, unset, budget or Budget()), tuple(used), tuple(unset))


def reference_at(text: str, offset: int) -> Variable:
    """Parses the reference in braces at an offset and ignores the rest. Raises Refused."""
    return _Parser(text).braced(offset, 0)[0]


def variables(pieces: tuple[Piece, ...]) -> Iterator[Variable]:
    """All references, including those in texts of operators."""
    for piece in pieces:
        if isinstance(piece, Variable):
            yield piece
            yield from variables(piece.argument)


def escaped(text: str) -> str:
    """Escapes a text, so that interpolation returns it unchanged."""
    return text.replace("$", "$$")


class _Parser:
    def __init__(self, text: str) -> None:
        self.text = text

    def pieces(self, at: int, depth: int) -> tuple[tuple[Piece, ...], int]:
        """Parses to the end of the text, or to the closing brace if inside braces (depth > 0); returns the pieces and
        the end. Braces of plain text are counted, as in `${A:-{}}`."""
        pieces: list[Piece] = []
        plain, inner = at, 0
        while sign := _SIGN.search(self.text, at):
            at = sign.end()
            if sign[0] == "}" and depth and not inner:
                return (*_joined([*pieces, self.text[plain : sign.start()]]),), sign.start()
            if sign[0] in "{}":
                inner += 1 if sign[0] == "{" else -1
                continue
            piece: Piece = "$" if sign[0] == "$$" else Variable(sign[0][1:], sign.start(), at, braced=False)
            if sign[0] == "${":
                piece, at = self.braced(sign.start(), depth)
            pieces += [self.text[plain : sign.start()], piece]
            plain = at
        return (*_joined([*pieces, self.text[plain:]]),), len(self.text)

    def braced(self, at: int, depth: int) -> tuple[Variable, int]:
        name = _NAME.match(self.text, at + 2)
        if name is None or depth >= MOST_DEPTH:
            raise self.wrong(at, "no name of a variable")
        end, argument, operator = name.end(), tuple[Piece, ...](), ""
        if self.text[end : end + 1] != "}":
            operator = next((o for o in _OPERATORS if self.text.startswith(o, end)), "")
            if not operator and end < len(self.text):
                raise self.wrong(at, f"{self.text[end]!r} after the name")
            argument, end = self.pieces(end + len(operator), depth + 1)
        if end >= len(self.text):
            raise self.wrong(at, "no closing brace")
        return Variable(name.group(), at, end + 1, True, operator, argument), end + 1

    def wrong(self, at: int, why: str) -> Refused:
        shown = self.text[at : at + 30].partition("\n")[0]
        remedy = "${NAME}, ${NAME:-default}, or $$ for a dollar sign of its own"
        return Refused(at, f"'{shown}' is not a variable: {why}", remedy)


def _joined(pieces: list[Piece]) -> Iterator[Piece]:
    """Joins adjacent plain texts and drops empty ones."""
    for plain, group in groupby((p for p in pieces if p), lambda piece: isinstance(piece, str)):
        if plain:
            yield "".join(map(str, group))
        else:
            yield from group


def _fill(pieces: tuple[Piece, ...], lookup: Lookup, unset: dict[str, None], budget: Budget) -> str:
    return "".join(piece if isinstance(piece, str) else _value(piece, lookup, unset, budget) for piece in pieces)


def _value(variable: Variable, lookup: Lookup, unset: dict[str, None], budget: Budget) -> str:
    """The value of one reference. An unused text is filled in too, so that required variables in it are checked, like
    Compose does."""
    value, operator = lookup(variable.name), variable.operator
    budget.take(variable, value or "")
    argument = _fill(variable.argument, lookup, unset, budget)
    there = bool(value) if operator.startswith(":") else value is not None
    match operator[-1:]:
        case "-":
            return (value or "") if there else argument
        case "+":
            return argument if there else ""
        case "?" if not there:
            how = "empty or not set" if operator == ":?" else "not set"
            said = f": {argument}" if argument else ""
            remedy = f"a value of {variable.name} in the environment or an env file"
            raise Refused(variable.start, f"variable {variable.name} is {how}{said}", remedy, variable.name)
    if value is None:
        unset[variable.name] = None
    return value or ""
