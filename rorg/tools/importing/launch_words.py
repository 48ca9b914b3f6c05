"""Reads the texts of ROS 2 launch files: characters and substitutions, `$(name argument...)`."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable
from dataclasses import dataclass

DEEPEST = 20
"""Levels of substitutions in each other."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
_PLACE = "\ue000{}\ue001"
"""Stands for a substitution while words are split; launch files have no characters of private use."""
_PLACES = re.compile("\ue000([0-9]+)\ue001")


class Refusal(Exception):
    """Something in a launch file that cannot be carried over, with what to do instead."""

    def __init__(self, message: str, remedy: str = "") -> None:
        super().__init__(message)
        self.message, self.remedy = message, remedy


class Missing(Refusal):
    """A value that the person who imports must give; nothing can be left out instead."""


@dataclass(frozen=True, slots=True)
class Call:
    """One substitution."""

    name: str
    arguments: tuple[Text, ...]


Text = tuple[str | Call, ...]


def parse(text: str) -> Text:
    """The pieces of a text. Raises Refusal."""
    if "$(" not in text and "\\" not in text:
        return (text,)
    return _Parser(text).template("", 0)


def split(text: str, filled: Callable[[Text], str]) -> list[str]:
    """The words of a command line. Spaces in the value of a substitution split nothing. Raises Refusal."""
    calls: list[Call] = []

    def place(piece: str | Call) -> str:
        if isinstance(piece, str):
            if "\ue000" in piece:
                raise Refusal("a character of private use (U+E000) in a command line", "to drop it")
            return piece
        calls.append(piece)
        return _PLACE.format(len(calls) - 1)

    line = "".join(map(place, parse(text)))
    try:
        words = shlex.split(line)
    except ValueError as error:
        raise Refusal(f"not a command line: {error}") from error
    return [_PLACES.sub(lambda match: filled((calls[int(match[1])],)), word) for word in words]


class _Parser:
    def __init__(self, text: str) -> None:
        self.text, self.at = text, 0

    def template(self, end: str, depth: int) -> Text:
        """Pieces up to a character, or to the end of the text."""
        pieces: list[str | Call] = []
        while self.at < len(self.text) and self.text[self.at] != end:
            pieces.append(self._piece(depth))
        return tuple(pieces)

    def _piece(self, depth: int) -> str | Call:
        if self.text.startswith("$(", self.at):
            return self._call(depth + 1)
        if self.text[self.at] == "\\" and self.at + 1 < len(self.text):
            self.at += 1
        self.at += 1
        return self.text[self.at - 1]

    def _call(self, depth: int) -> Call:
        if depth > DEEPEST:
            raise Refusal(f"more than {DEEPEST} substitutions in each other")
        start = self.at
        match = _NAME.match(self.text, start + 2)
        if match is None:
            raise Refusal(f"{self.text[start : start + 20]}: a substitution without a name", "$(var NAME)")
        self.at = match.end()
        arguments: list[Text] = []
        while self._space():
            arguments.append(self._argument(depth))
        if not self.text.startswith(")", self.at):
            raise Refusal(f"$({match[0]} has no closing bracket where it should end", "quotes around its argument")
        self.at += 1
        return Call(match[0], tuple(arguments))

    def _space(self) -> bool:
        """Skips spaces; whether an argument follows."""
        start = self.at
        while self.at < len(self.text) and self.text[self.at].isspace():
            self.at += 1
        return self.at > start and not self.text.startswith(")", self.at)

    def _argument(self, depth: int) -> Text:
        quote = self.text[self.at : self.at + 1]
        if quote in ("'", '"'):
            self.at += 1
            pieces = self.template(quote, depth)
            if not self.text.startswith(quote, self.at):
                raise Refusal(f"an argument has no closing {quote}")
            self.at += 1
            return pieces
        bare: list[str | Call] = []
        while self.at < len(self.text) and not (self.text[self.at].isspace() or self.text[self.at] == ")"):
            bare.append(self._piece(depth))
        return tuple(bare)
