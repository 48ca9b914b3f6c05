"""Splits a command that is written as one text, in the same way as Compose.

Compose knows quotes and backslashes but runs no shell: it stops at the first separate ; & | < > and ignores the rest.
$(...) and `...` are parts of a word, kept as written (measured with 2.26.1).
"""

from __future__ import annotations

from dataclasses import dataclass, field

ENDS = ";&|<>"
SPACES = " \t\r\n"
BACK, SUBSTITUTION = "`", "$("
"""What a character may be inside of, besides quotes."""


def split(text: str) -> tuple[list[str], str]:
    """The words, and the rest that Compose ignores. Raises ValueError for unclosed quotes and for brackets outside of
    quotes, which Compose refuses."""
    splitter = _Words()
    at = 0
    while at < len(text) and not splitter.ended(text[at]):
        if text[at] == "\\" and splitter.quote != "'":
            at += 1
            if at == len(text):
                raise ValueError("not a command line: it ends with a backslash")
            splitter.add(text[at])
        else:
            splitter.take(text[at])
        at += 1
    if splitter.quote or splitter.inside:
        raise ValueError("not a command line: a quote is not closed")
    splitter.space()
    return splitter.words, text[at:]


@dataclass
class _Words:
    words: list[str] = field(default_factory=list)
    word: str | None = None
    quote: str = ""
    inside: str = ""

    def ended(self, sign: str) -> bool:
        """Whether the command ends here. Digits before > name a file descriptor, so they are not a word."""
        if sign not in ENDS or self.quote or self.inside:
            return False
        if sign == ">" and self.word and self.word[0] in "0123456789":
            self.word = None
        return True

    def take(self, sign: str) -> None:
        if sign in SPACES:
            self.add(sign) if self.quote or self.inside else self.space()
        elif sign in ("'", '"') and self.inside != SUBSTITUTION and self.quote in ("", sign):
            self.quote = "" if self.quote else sign
            self.word = self.word or ""
        elif sign in "`()" and not self.quote:
            self._bracket(sign)
        else:
            self.add(sign)

    def _bracket(self, sign: str) -> None:
        if sign == "`" and self.inside != SUBSTITUTION:
            self.inside = "" if self.inside else BACK
        elif sign == "(" and self.inside != BACK:
            if self.inside or not (self.word or "").endswith("$"):
                raise ValueError("not a command line: '(' outside of quotes")
            self.inside = SUBSTITUTION
        elif sign == ")" and self.inside != BACK:
            if not self.inside:
                raise ValueError("not a command line: ')' outside of quotes")
            self.inside = ""
        self.add(sign)

    def add(self, sign: str) -> None:
        self.word = (self.word or "") + sign

    def space(self) -> None:
        if self.word is not None:
            self.words.append(self.word)
            self.word = None
