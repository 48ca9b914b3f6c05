"""Makes foreign text safe for a terminal: output of programs, reasons, names. A terminal obeys control characters, so
text only reaches it with them escaped."""

from __future__ import annotations

import codecs
import re
from typing import Any, Protocol

COLOUR = re.compile(r"(\x1b\[[0-9;:]*m)")
"""Colours, the only control sequences that are kept in a log."""
BEGUN = re.compile(r"(\x1b(\[[0-9;:]{0,30})?|\r)\Z")
"""The begin of a colour or of a line end, whose rest has not come yet."""
PLAIN = "\x1b[0m"
"""Resets all colours."""


class Masker(Protocol):
    """A core.masking.Masker, which only processes that know secrets import."""

    def text(self, text: str) -> str: ...
    def value(self, value: Any) -> Any: ...


_maskers: list[Masker] = []


def hide(masker: Masker) -> None:
    """Masks the secrets of this masker in everything shown from now on."""
    _maskers.append(masker)


def shown(value: Any) -> Any:
    """JSON values without secrets."""
    for masker in _maskers:
        value = masker.value(value)
    return value


def printable(text: object) -> str:
    """One line without secrets, with every character escaped that is not printable, such as controls, line ends,
    direction marks and zero-width characters: \x1b or \u202e."""
    text = str(text)
    for masker in _maskers:
        text = masker.text(text)
    return text if text.isprintable() else "".join(c if c.isprintable() else _escaped(c) for c in text)


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode("ascii")


def lines(text: object) -> str:
    """Several lines made by rorg, each printable."""
    return "\n".join(map(printable, str(text).split("\n")))


def entry(head: str, text: object) -> str:
    """An entry after its time; further lines are indented, so that it is clear where it ends."""
    first, *rest = str(text).split("\n")
    return "\n".join([f"{head}{printable(first)}", *(f"{' ' * len(head)}| {printable(line)}" for line in rest)])


class LogText:
    """A log in chunks that end anywhere: lines, tabs and colours are kept."""

    def __init__(self) -> None:
        self._decoder, self._begun = codecs.getincrementaldecoder("utf-8")("backslashreplace"), ""

    def text(self, chunk: bytes, end: bool = False) -> str:
        """What can be shown so far; at the `end` everything left, and colours are reset."""
        text = self._begun + self._decoder.decode(chunk, end)
        begun = None if end else BEGUN.search(text)
        text, self._begun = (text[: begun.start()], begun[0]) if begun else (text, "")
        parts = COLOUR.split(text.replace("\r\n", "\n"))
        shown = "".join(part if index % 2 else _kept(part) for index, part in enumerate(parts))
        return shown + PLAIN if end else shown


def _kept(text: str) -> str:
    return "".join(c if c.isprintable() or c in "\n\t" else _escaped(c) for c in text)
