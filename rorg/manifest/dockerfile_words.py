"""Words of a Dockerfile as Docker expands them: variables, quotes and escapes.

The rules are those of Docker's own word lexer (its documentation: "environment replacement"). It resembles a shell but
is not one: `${name^^}` and commands in `$(...)` do not exist.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

SPACES = "\t\n\v\f\r \x85\xa0\u1680" + "".join(map(chr, range(0x2000, 0x200B))) + "\u2028\u2029\u202f\u205f\u3000"
"""Characters that Docker counts as white space."""
DEPTH = 50
"""Maximum nesting of variables in defaults."""
MOST = 65535
"""Characters that values may add to one text; no reference is that long."""
MOST_OF_A_PATTERN = 1000
"""Characters of a pattern, and of a value that is matched against it."""
NAME = re.compile(r"[0-9]+|[@*#?\-$!]|[^\W\d]\w*")
Pieces = list[tuple[str, bool]]
"""(text, whether its spaces end words)."""


class BadWord(ValueError):
    """The text cannot be expanded; the message has the reason."""


@dataclass(slots=True)
class Lexer:
    """One pass over a text. Raises BadWord."""

    text: str
    values: Mapping[str, str]
    escape: str = "\\"
    raw: bool = False
    """Keep quotes and escapes."""
    keep: bool = False
    """Keep variables that have no value."""
    used: set[str] = field(default_factory=set)
    """Names of all variables in the text."""
    _at: int = 0
    _depth: int = 0
    _filled: int = 0
    _raw_escapes: bool = False

    def filled(self) -> str:
        """Returns the text with all variables filled in; unset ones are empty."""
        return _joined(self._until("", self.raw))

    def words(self) -> list[str]:
        """Like filled(), but split at spaces outside quotes."""
        words: list[list[str]] = [[]]
        for text, splits in self._until("", self.raw):
            for char in text if splits else [text]:
                if splits and char in SPACES:
                    words.append([])
                else:
                    words[-1].append(char)
        return [word for word in map("".join, words) if word]

    def _peek(self) -> str:
        return self.text[self._at : self._at + 1]

    def _next(self) -> str:
        self._at += 1
        return self.text[self._at - 1 : self._at]

    def _until(self, stop: str, raw_escapes: bool) -> Pieces:
        before, self._raw_escapes = self._raw_escapes, raw_escapes
        pieces: Pieces = []
        while (char := self._peek()) != stop:
            if not char:
                raise BadWord(f"{stop} is missing")
            if char in "'\"":
                pieces.append((self._single() if char == "'" else self._double(), False))
            elif char == "$":
                pieces.append((self._variable(), True))
            elif char == self.escape:
                self._next()
                pieces.append(((char if raw_escapes else "") + self._next(), False))
            else:
                pieces.append((self._next(), True))
        self._next()
        self._raw_escapes = before
        return pieces

    def _single(self) -> str:
        end = self.text.find("'", self._at + 1)
        if end < 0:
            raise BadWord("a single quote is not closed")
        start, self._at = self._at, end + 1
        return self.text[start : end + 1] if self.raw else self.text[start + 1 : end]

    def _double(self) -> str:
        quote = self._next() if self.raw else self._next()[:0]
        parts = [quote]
        while (char := self._peek()) != '"':
            if not char:
                raise BadWord("a double quote is not closed")
            if char == "$":
                parts.append(self._variable())
                continue
            self._next()
            if char == self.escape and not self._peek():
                continue
            if char == self.escape and self._peek() in ('"', "$", self.escape):
                char = (char if self._raw_escapes else "") + self._next()
            parts.append(char)
        self._next()
        return "".join([*parts, quote])

    def _name(self) -> str:
        match = NAME.match(self.text, self._at)
        if not match:
            return ""
        self._at = match.end()
        self.used.add(match[0])
        return match[0]

    def _variable(self) -> str:
        start = self._at
        self._next()
        if self._peek() != "{":
            name = self._name()
            unset = f"${name}" if self.keep or not name else ""
            return self._counted(self.values.get(name, unset))
        self._next()
        self._depth += 1
        if self._depth > DEPTH:
            raise BadWord(f"more than {DEPTH} variables within each other")
        name = self._name()
        value = self._braced(name)
        self._depth -= 1
        return self.text[start : self._at] if self.keep and name not in self.values else self._counted(value)

    def _counted(self, value: str) -> str:
        self._filled += len(value)
        if self._filled > MOST and not self.keep:
            raise BadWord(f"its variables have more than {MOST} characters")
        return value

    def _braced(self, name: str) -> str:
        """Applies the operator after the name in ${name...} to its value."""
        value = self.values.get(name)
        sign = self._next()
        if not name or not sign:
            raise BadWord("${...} is not well formed")
        if sign == "}":
            return value or ""
        if sign == "/":
            return self._replaced(value or "")
        if sign == ":":
            sign = self._next()
            value = value or None
        if not sign or sign not in "-+?#%":
            raise BadWord(f"${{{name}...}} has a sign that Docker does not know")
        word = _joined(self._until("}", sign in "#%"))
        if sign == "-":
            return word if value is None else value
        if sign == "+":
            return "" if value is None else word
        if sign == "?":
            if value is None and not self.keep:
                raise BadWord(f"{name}: {word or 'it has no value'}")
            return value or ""
        return _trimmed(sign, word, value or "")

    def _replaced(self, value: str) -> str:
        """Expands ${name/pattern/text}, which replaces once, and ${name//pattern/text}, which replaces everywhere."""
        everywhere = self._peek() == "/"
        if everywhere:
            self._next()
        word = _joined(self._until("/", True))
        pattern, text = _pattern(word, value, longest=True), _joined(self._until("}", True))
        return pattern.sub(lambda match: text if match[0] else "", value, not everywhere) if word else value


def _joined(pieces: Pieces) -> str:
    return "".join(text for text, _ in pieces)


def _trimmed(sign: str, word: str, value: str) -> str:
    """Expands ${name#pattern} and ${name%pattern}; a double sign removes the longest match."""
    back = -1 if sign == "%" else 1
    match = _pattern(word.removeprefix(sign), value, word.startswith(sign), back).match(value[::back])
    return value[::back][match.end() if match else 0 :][::back]


def _pattern(word: str, value: str, longest: bool, back: int = 1) -> re.Pattern[str]:
    """Returns an expression that finds the longest or the shortest match, in bounded time for every pattern. `back` is
    -1 to read both backwards. Raises BadWord for a bad pattern, and if the pattern or the value is too long."""
    if max(len(word), len(value)) > MOST_OF_A_PATTERN:
        raise BadWord(f"a pattern, or its value, has more than {MOST_OF_A_PATTERN} characters")
    signs, parts = re.findall(r"\\.?|.", word, re.DOTALL), [""]
    if bad := next((sign for sign in signs if sign[0] == "\\" and sign[1:] not in tuple("*?\\}/")), ""):
        raise BadWord(f"a pattern has no {bad}")
    for sign in signs[::back]:
        if sign == "*":
            parts.append("")
        else:
            parts[-1] += "." if sign == "?" else re.escape(sign[-1])
    last = f".*{parts.pop()}" if longest and len(parts) > 1 else ""
    return re.compile(parts[0] + "".join(f"(?>.*?{part})" for part in parts[1:]) + last, re.DOTALL)
