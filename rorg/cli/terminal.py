"""What others wrote, as it may be shown: reasons of programs, their output, what they call themselves. A terminal obeys
what it is sent, so nothing reaches it but text that is seen as what it is."""

from __future__ import annotations

import codecs
import re
from typing import Any, Protocol

COLOUR = re.compile(r"(\x1b\[[0-9;:]*m)")
"""What is kept of a log: it changes colours, and nothing else."""
BEGUN = re.compile(r"(\x1b(\[[0-9;:]{0,30})?|\r)\Z")
"""A colour, or the end of a line, of which only a part has come."""
PLAIN = "\x1b[0m"
"""Takes all colours back."""


class Masker(Protocol):
    """See core.masking, which is loaded by those who know a secret."""

    def text(self, text: str) -> str: ...
    def value(self, value: Any) -> Any: ...


_maskers: list[Masker] = []


def hide(masker: Masker) -> None:
    """From now on nothing is shown that this one hides."""
    _maskers.append(masker)


def shown(value: Any) -> Any:
    """Plain JSON as it may be shown."""
    for masker in _maskers:
        value = masker.value(value)
    return value


def printable(text: object) -> str:
    """One line without secrets: whatever is no letter, sign or plain space (controls, line ends, what turns the
    direction of writing, what has no width) as its escape, \\x1b or \\u202e."""
    text = str(text)
    for masker in _maskers:
        text = masker.text(text)
    return text if text.isprintable() else "".join(c if c.isprintable() else _escaped(c) for c in text)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")


def lines(text: object) -> str:
    """Several lines that rorg has made, each one printable."""
    return "\n".join(map(printable, str(text).split("\n")))


def entry(head: str, text: object) -> str:
    """Something that happened, after its time. What has several lines is seen to be one thing."""
    first, *rest = str(text).split("\n")
    return "\n".join([f"{head}{printable(first)}", *(f"{' ' * len(head)}| {printable(line)}" for line in rest)])


class LogText:
    """A log as it comes, in chunks that end anywhere: lines, tabs and colours are kept."""

    def __init__(self) -> None:
        self._decoder, self._begun = codecs.getincrementaldecoder("utf-8")("backslashreplace"), ""

    def text(self, chunk: bytes, end: bool = False) -> str:
        """What can be shown by now; at the `end` all that is left, without colours from then on."""
        text = self._begun + self._decoder.decode(chunk, end)
        begun = None if end else BEGUN.search(text)
        text, self._begun = (text[: begun.start()], begun[0]) if begun else (text, "")
        parts = COLOUR.split(text.replace("\r\n", "\n"))
        shown = "".join(part if index % 2 else _kept(part) for index, part in enumerate(parts))
        return shown + PLAIN if end else shown


def _kept(text: str) -> str:
    return "".join(c if c.isprintable() or c in "\n\t" else _escaped(c) for c in text)
