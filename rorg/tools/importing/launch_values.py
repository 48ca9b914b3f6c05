"""Fills in the substitutions of ROS 2 launch files.

What only the robot knows stays in the text in one form, `$(find-pkg-share PACKAGE)` and the like (LATE), until the
service's command asks for it."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from rorg.manifest.ros import UNSENDABLE
from rorg.model.bounds import TooMuch
from rorg.model.diagnostics import Where
from rorg.tools.importing.launch_expression import evaluate
from rorg.tools.importing.launch_packages import Packages
from rorg.tools.importing.launch_words import Call, Missing, Refusal, Text, parse, split

MOST_FILLED = 1 << 20
"""Characters that substitutions may add to a launch file and its includes."""
LATE = re.compile(r"\$\((find-pkg-share|find-pkg-prefix|find-exec) ([A-Za-z0-9_./+-]+)\)")
"""Substitutions that only the robot can resolve, when a service starts."""
TRUE, FALSE = ("true", "1"), ("false", "0")


def mapped(text: str, plain: Callable[[str], str], late: Callable[[re.Match[str]], str]) -> str:
    """A text with its plain parts and its late parts replaced. Plain parts are not empty, unless the text is."""
    pieces, at = list[str](), 0
    for match in LATE.finditer(text):
        pieces += [plain(text[at : match.start()])] if match.start() > at else []
        pieces.append(late(match))
        at = match.end()
    return "".join([*pieces, *([plain(text[at:])] if at < len(text) or not text else [])])


@dataclass(frozen=True)
class Setting:
    """A parameter; its name has dots between its levels."""

    name: str
    value: Any


@dataclass(frozen=True)
class ParameterFile:
    """A file with parameters, as the node sees it."""

    path: str


Parameters = tuple[Setting | ParameterFile, ...]


@dataclass
class Scope:
    """What applies to the actions of a group, and changes while they are read."""

    variables: dict[str, str] = field(default_factory=dict)
    environment: dict[str, str] = field(default_factory=dict)
    namespace: str = ""
    parameters: Parameters = ()
    remaps: tuple[tuple[str, str], ...] = ()

    @property
    def size(self) -> int:
        """Characters that each program in it takes over."""
        texts = [*self.environment.values(), *(text for pair in self.remaps for text in pair)]
        values = [one.path if isinstance(one, ParameterFile) else f"{one.name}{one.value}" for one in self.parameters]
        return sum(map(len, texts)) + sum(map(len, values))

    def copy(self) -> Scope:
        return replace(self, variables=dict(self.variables), environment=dict(self.environment))


@dataclass
class Filler:
    """Fills texts of launch files. Raises Refusal, and TooMuch."""

    packages: Packages
    environment: Mapping[str, str]
    """Variables of the person who imports."""
    taken: dict[str, Where] = field(default_factory=dict)
    """Variables that were read, and where first."""
    local: dict[str, Where] = field(default_factory=dict)
    """Folders of this machine that no package has, and where they are named first."""
    filled: int = 0

    def fill(self, text: str, scope: Scope, where: Where) -> str:
        """The text with its substitutions filled in."""
        filled = self._text(parse(text), scope, where)
        if UNSENDABLE.search(filled):
            raise Refusal("a control character, which no launch file can hold", "to drop it")
        return filled

    def words(self, text: str, scope: Scope, where: Where) -> tuple[str, ...]:
        """The words of a command line."""
        return tuple(split(text, lambda pieces: self._text(pieces, scope, where)))

    def _text(self, text: Text, scope: Scope, where: Where) -> str:
        return "".join(piece if isinstance(piece, str) else self._call(piece, scope, where) for piece in text)

    def _call(self, call: Call, scope: Scope, where: Where) -> str:
        arguments = [self._text(argument, scope, where) for argument in call.arguments]
        value = self._value(call.name, arguments, scope, where)
        self.spend(len(value), where)
        return value

    def spend(self, count: int, where: Where) -> None:
        """Counts characters that were filled in."""
        self.filled += count
        if self.filled > MOST_FILLED:
            raise TooMuch(where, f"substitutions add more than {MOST_FILLED >> 20} MiB", "shorter values")

    def _value(self, name: str, arguments: Sequence[str], scope: Scope, where: Where) -> str:
        if name == "command":
            message = f"$(command {' '.join(arguments)[:60]}): an import runs no commands"
            raise Refusal(message, "the text that it prints, or a Service that runs `ros2 launch` with the file")
        if name in ("var", "env"):
            return self._variable(name, arguments, scope, where)
        if name in ("dirname", "filename"):
            path = Path(where.file).parent if name == "dirname" else Path(where.file)
            shown = self.packages.shown(path)
            if shown == str(path):
                self.local.setdefault(shown, where)
            return shown
        if name == "exec-in-pkg" and len(arguments) == 2:
            return f"$(find-pkg-prefix {arguments[1]})/lib/{arguments[1]}/{arguments[0]}"
        if name in ("find-pkg-share", "find-pkg-prefix", "find-exec") and len(arguments) == 1:
            late = f"$({name} {arguments[0]})"
            if LATE.fullmatch(late):
                return late
        if name not in _FUNCTIONS:
            raise Refusal(f"$({name} ...) cannot be evaluated by an import", "an argument with the value")
        if not _FUNCTIONS[name][0] <= len(arguments) <= _FUNCTIONS[name][1]:
            raise Refusal(f"$({name} ...) has {len(arguments)} arguments", "quotes around each argument with spaces")
        if any(LATE.search(argument) for argument in arguments):
            raise Refusal(f"$({name} ...) depends on a path that only the robot knows", "an argument with the value")
        return _FUNCTIONS[name][2](*arguments)

    def _variable(self, kind: str, arguments: Sequence[str], scope: Scope, where: Where) -> str:
        """The value of a variable of launch files or of the environment, or its default."""
        name, *default = arguments or [""]
        values = scope.variables if kind == "var" else {**self.environment, **scope.environment}
        if kind == "env" and name in self.environment and name not in scope.environment:
            self.taken.setdefault(name, where)
        if name in values:
            return values[name]
        if len(default) == 1:
            return default[0]
        if kind == "var":
            raise Missing(f"the variable {name} has no value", f"{name}:=VALUE after the file")
        raise Missing(f"the environment variable {name} is not set", f"{name}=VALUE before the command")


def truth(text: str) -> bool:
    """The value of a condition. Raises Refusal."""
    word = text.strip().lower()
    if word in TRUE or word in FALSE:
        return word in TRUE
    raise Refusal(f"'{text[:60]}' is neither true nor false", "true, false, 1 or 0")


def _said(value: bool) -> str:
    return str(value).lower()


def _equal(left: str, right: str) -> bool:
    """Whether two texts are equal as ROS 2 compares them: 1 is true, and 1.0 is 1."""
    words = [text.lower() for text in (left, right)]
    if all(word in ("true", "1", "false", "0") for word in words):
        return truth(left) == truth(right)
    try:
        return math.isclose(float(left), float(right))
    except ValueError:
        return left == right


_FUNCTIONS: Mapping[str, tuple[int, int, Callable[..., str]]] = {
    "eval": (1, 2, lambda expression, _="": evaluate(expression)),
    "equals": (2, 2, lambda left, right: _said(_equal(left, right))),
    "not-equals": (2, 2, lambda left, right: _said(not _equal(left, right))),
    "not": (1, 1, lambda value: _said(not truth(value))),
    "and": (2, 2, lambda *values: _said(all([truth(value) for value in values]))),
    "or": (2, 2, lambda *values: _said(any([truth(value) for value in values]))),
    "all": (0, 100, lambda *values: _said(all([truth(value) for value in values]))),
    "any": (0, 100, lambda *values: _said(any([truth(value) for value in values]))),
    "if": (2, 3, lambda test, yes, no="": yes if truth(test) else no),
}
"""Name -> fewest and most arguments, and what it gives."""
