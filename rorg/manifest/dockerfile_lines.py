"""Instructions of a Dockerfile, with the position of each character in the file.

Rewriting one word and nothing else needs the position of each. Docker's own parser reports only lines, and the library
dockerfile-parse supports neither heredocs nor variables with defaults.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from rorg.manifest.dockerfile_words import SPACES, BadWord, Lexer

DIRECTIVES = {"escape", "syntax", "check"}
WITH_HEREDOCS = {"RUN", "COPY", "ADD"}
BOM = "\ufeff"
WORD = re.compile(r"[^\t\v\f\r ]*")
"""Words of instructions and of FROM end at fewer characters than words of shells."""
MOST = 300
"""Characters of a message."""
HEREDOC = re.compile(r"[0-9]*<<(-?)([^<]*)")


class DockerfileError(ValueError):
    """Docker would refuse the file; the message has the reason."""

    def __init__(self, message: str, line: int) -> None:
        super().__init__(message if len(message) <= MOST else f"{message[:MOST]}...")
        self.line = line
        """From 1."""


@dataclass(frozen=True, slots=True)
class Token:
    """A part of an instruction."""

    text: str
    places: Sequence[int]
    """Position of each character in the file."""
    quotes: Sequence[str] = ()
    """The quote around each character if quotes were removed, else ""."""

    def part(self, start: int, end: int | None = None) -> Token:
        return Token(self.text[start:end], self.places[start:end], self.quotes[start:end])

    def stripped(self) -> Token:
        start = len(self.text) - len(self.text.lstrip(SPACES))
        return self.part(start, max(start, len(self.text.rstrip(SPACES))))

    def cut(self, separator: str) -> tuple[Token, Token]:
        """The parts before and after the separator."""
        at = self.text.find(separator)
        return (self, self.part(len(self.text))) if at < 0 else (self.part(0, at), self.part(at + len(separator)))


@dataclass(frozen=True, slots=True)
class Instruction:
    """One instruction with its continuation lines, but without the content of its heredocs."""

    name: str
    """In upper case."""
    flags: Sequence[Token]
    """Without quotes: "--from=x"."""
    arguments: Token
    line: int
    """Line of its name, from 1."""
    heredocs: bool = False


@dataclass(frozen=True, slots=True)
class Script:
    """A file split into instructions, which are not interpreted yet."""

    escape: str
    syntax: bool
    """Whether it has a `# syntax=` line."""
    instructions: Sequence[Instruction]


@dataclass(frozen=True, slots=True)
class _Line:
    number: int
    text: Token

    @property
    def says_nothing(self) -> bool:
        """Whether it is blank or a comment; both may also be between a line and its continuation."""
        return self.text.text.lstrip(SPACES)[:1] in ("", "#")


def script(text: str) -> Script:
    """Raises DockerfileError."""
    lines = list(_lines(text))
    escape, syntax = _directives(lines)
    return Script(escape, syntax, tuple(_instructions(iter(lines), escape)))


def _lines(text: str) -> Iterator[_Line]:
    """Splits at line feeds only, and drops carriage returns before them."""
    at = len(BOM) if text.startswith(BOM) else 0
    for number, line in enumerate(text[at:].split("\n"), 1):
        kept = line.rstrip("\r")
        yield _Line(number, Token(kept, range(at, at + len(kept))))
        at += len(line) + 1


def _directives(lines: Sequence[_Line]) -> tuple[str, bool]:
    """Returns the escape character, and whether there is a syntax line. Directives end at the first other line."""
    directives: dict[str, str] = {}
    for line in lines:
        text = line.text.text.lstrip(SPACES)
        key, _, value = (part.strip(SPACES) for part in text[1:].partition("="))
        key = key.lower()
        if not text.startswith("#") or key not in DIRECTIVES or not value:
            break
        if key in directives:
            raise DockerfileError(f"only one {key} parser directive can be used", line.number)
        if key == "escape" and value not in ("\\", "`"):
            raise DockerfileError(f"the escape character is \\ or `, not {value}", line.number)
        directives[key] = value
    return directives.get("escape", "\\"), "syntax" in directives


def _instructions(rest: Iterator[_Line], escape: str) -> Iterator[Instruction]:
    for line in rest:
        if line.says_nothing:
            continue
        whole = _continued(line, rest, escape).stripped()
        name, arguments = _first_word(whole)
        flags, arguments = _flags(arguments)
        inner = _first_word(arguments)[0] if name == "ONBUILD" else name
        ends = _heredocs(whole.text) if inner in WITH_HEREDOCS and "<<" in whole.text else []
        for end, tabs in ends:
            if not any((after.text.text.lstrip("\t") if tabs else after.text.text) == end for after in rest):
                raise DockerfileError(f"the heredoc {end} does not end", line.number)
        if name:
            yield Instruction(name, flags, arguments.stripped(), line.number, bool(ends))


def _continued(line: _Line, rest: Iterator[_Line], escape: str) -> Token:
    """Joins a line with its continuations: a line continues if it ends with the escape character, not counting spaces
    and tabs after it."""
    texts: list[str] = []
    places: list[int] = []
    current: _Line | None = line
    while current:
        kept = current.text.text.rstrip(" \t")
        goes_on = kept.endswith(escape) and not kept.endswith(escape * 2)
        body = current.text.part(0, len(kept) - 1) if goes_on else current.text
        texts.append(body.text)
        places.extend(body.places)
        current = next((after for after in rest if not after.says_nothing), None) if goes_on else None
    return Token("".join(texts), places)


def _first_word(whole: Token) -> tuple[str, Token]:
    """Returns the first word in upper case, and the rest."""
    match = WORD.match(whole.text)
    end = match.end() if match else 0
    return whole.text[:end].upper(), whole.part(end).stripped()


def _flags(arguments: Token) -> tuple[list[Token], Token]:
    """Returns the leading words that start with "--", without quotes, and the rest. In them, \\ always escapes, even if
    the file has another escape character."""
    flags: list[Token] = []
    text, at = arguments.text, 0
    while text.startswith("--", at):
        kept: list[tuple[int, str]] = []
        quote = ""
        while at < len(text) and (quote or text[at] not in SPACES):
            char = text[at]
            if char == quote or (not quote and char in "'\""):
                quote = "" if quote else char
            else:
                at += char == "\\"
                kept.append((at, quote))
            at += 1
        kept = [(place, quote) for place, quote in kept if place < len(text)]
        word = "".join(text[place] for place, _ in kept)
        at = next((place for place in range(at, len(text)) if text[place] not in SPACES), len(text))
        if word == "--":
            break
        flags.append(Token(word, [arguments.places[place] for place, _ in kept], [quote for _, quote in kept]))
    return flags, arguments.part(at)


def _heredocs(text: str) -> list[tuple[str, bool]]:
    """Returns, in order, the end line of each heredoc of an instruction, and whether tabs before it are ignored. "<<"
    counts only at the start of a word with a name after it: not in quotes, not in "1<<2", not alone."""
    try:
        words = Lexer(text, {}, raw=True, keep=True).words()
        matches = [match for word in words if (match := HEREDOC.fullmatch(word))]
        names = [(Lexer(match[2], {}, keep=True).words(), bool(match[1])) for match in matches]
    except BadWord:
        return []
    return [(name[0], tabs) for name, tabs in names if len(name) == 1]
