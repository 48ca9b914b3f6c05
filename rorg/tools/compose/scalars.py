"""Forms of single values of a Compose file: texts, numbers, durations, paths."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from decimal import Decimal, InvalidOperation
from typing import Any

from rorg.model.diagnostics import nearest
from rorg.tools.compose.form import Context, Form
from rorg.tools.compose.nodes import Node

_SIZE = re.compile(r"(-?[0-9]+(?:\.[0-9]+)?|-?\.[0-9]+) ?([kKmMgGtTpP]?)(?:i|i?[bB])?$")
_POWERS = {"": 0, "k": 1, "m": 2, "g": 3, "t": 4, "p": 5}
_DURATION = re.compile(r"(-?[0-9]*\.?[0-9]+)(ns|us|µs|μs|ms|s|m|h|d|w)")
_SECONDS = {"ns": 1e-9, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ms": 1e-3, "s": 1.0, "m": 60.0, "h": 3600.0}
_TRUE = {**dict.fromkeys(("true", "yes", "y", "on"), True), **dict.fromkeys(("false", "no", "n", "off"), False)}


def size(text: str) -> int:
    """Bytes of `512`, `50M`, `1.5gb`, `64 KiB`: all units are powers of 1024, as in Compose. `1Gi` is the form of
    Kubernetes, which Compose refuses. Raises ValueError."""
    match = _SIZE.match(text.strip())
    if not match:
        raise ValueError(f"'{text}' is not an amount of memory")
    return int(Decimal(match[1]) * 1024 ** _POWERS[match[2].lower()])


def duration(text: str) -> float:
    """Seconds of `90s`, `1m30s`, `1h`. Raises ValueError."""
    total, at = 0.0, 0
    for match in _DURATION.finditer(text):
        if match.start() != at or match[2] not in _SECONDS:
            break
        total, at = total + float(match[1]) * _SECONDS[match[2]], match.end()
    if text == "0":
        return 0.0
    if not text or at != len(text):
        raise ValueError(f"'{text}' is not a duration")
    return round(total, 9)


def boolean(text: str) -> bool:
    """Whether a text means true. Raises ValueError."""
    try:
        return _TRUE[text.lower()]
    except KeyError:
        raise ValueError(f"'{text}' is neither true nor false") from None


def integer(text: str) -> int:
    """An integer in decimal digits, perhaps with a sign. Raises ValueError."""
    if not re.fullmatch(r"[-+]?[0-9]{1,19}", text):
        raise ValueError(f"'{text}' is not a whole number")
    return int(text)


def number(text: str) -> float:
    """A decimal number. Raises ValueError."""
    try:
        return float(Decimal(text))
    except (InvalidOperation, ValueError, OverflowError):
        raise ValueError(f"'{text}' is not a number") from None


def shown(value: object) -> str:
    """A scalar as Compose converts it to text: true, 5, 1.5; whole floats have no decimal point."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return _float(value)
    return str(value)


LARGE = 6
"""The power of ten from which a float has an exponent."""


def _float(value: float) -> str:
    """As %v of Go: with the fewest digits, and with an exponent from a million on."""
    digits = Decimal(repr(value)).normalize()
    exponent = digits.adjusted()
    if value and math.isfinite(value) and not -4 <= exponent < LARGE:
        return f"{format(digits.scaleb(-exponent), 'f')}e{exponent:+03d}"
    return format(digits, "f")


@dataclass(frozen=True)
class Scalar(Form):
    """A text or number, converted by `convert`, which raises ValueError with the reason if it cannot."""

    wanted: str
    types: tuple[type, ...]
    """Accepted YAML types; bool only if it is listed."""
    convert: Callable[[Any], Any] = lambda value: value
    one_of: tuple[str, ...] = ()

    def read(self, node: Node, name: str, context: Context) -> Node | None:
        value = node.value
        if value is None:
            return None
        if not isinstance(value, self.types) or (isinstance(value, bool) and bool not in self.types):
            remedy = self.otherwise(value)
            context.error(node, f"{name} is {node.kind()}, and must be {self.wanted}", remedy)
            return None
        try:
            value = self.convert(value)
        except ValueError as error:
            context.error(node, f"{name}: {error}", self.wanted)
            return None
        if self.one_of and value not in self.one_of:
            context.error(node, f"{name}: '{value}' is not known", nearest(str(value), self.one_of))
            return None
        return node.but(value)

    def otherwise(self, value: object) -> str:
        """A remedy for a value of a wrong type."""
        if str not in self.types or not isinstance(value, int | float | bool):
            return ""
        return self.wanted if self.convert is duration else f'"{shown(value)}"'


def _size(value: Any) -> int:
    return size(value) if isinstance(value, str) else int(value)


def _whole(value: Any) -> int:
    if isinstance(value, float) and value != int(value):
        raise ValueError(f"{value} is not a whole number")
    return integer(value) if isinstance(value, str) else int(value)


TEXT = Scalar("text", (str,))
LOOSE = Scalar("text, a number, true or false", (str, int, float, bool), shown)
NUMBER_OR_TEXT = Scalar("text or a number", (str, int, float), shown)
BOOL = Scalar("true or false", (bool, str), lambda v: boolean(v) if isinstance(v, str) else v)
INT = Scalar("a whole number", (int, float, str), _whole)
FLOAT = Scalar("a number", (int, float, str), lambda v: number(v) if isinstance(v, str) else float(v))
SIZE = Scalar("an amount of memory, as 512m", (int, float, str), _size)
DURATION = Scalar("a duration, as 1m30s", (str,), duration)


def one_of(*names: str) -> Scalar:
    """One of these texts."""
    return Scalar(f"one of {', '.join(names)}", (str,), one_of=names)


@dataclass(frozen=True)
class PathOf(Scalar):
    """A path of this machine, made absolute unless `kept` recognizes it as something else."""

    wanted: str = "a path"
    types: tuple[type, ...] = (str,)
    kept: Callable[[str], bool] = lambda _: False

    def read(self, node: Node, name: str, context: Context) -> Node | None:
        path = super().read(node, name, context)
        if path is None or self.kept(path.value):
            return path
        return path.but(context.path(path.value))
