"""Texts of Compose files that stand for numbers: amounts of memory, durations, true and false, command lines."""

from __future__ import annotations

import re
from decimal import Decimal, InvalidOperation

_SIZE = re.compile(r"(-?[0-9]+(?:\.[0-9]+)?|-?\.[0-9]+) ?([kKmMgGtTpP]?)(?:i?[bB])?$")
_POWERS = {"": 0, "k": 1, "m": 2, "g": 3, "t": 4, "p": 5}
_DURATION = re.compile(r"(-?[0-9]*\.?[0-9]+)(ns|us|µs|μs|ms|s|m|h|d|w)")
_SECONDS = {"ns": 1e-9, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ms": 1e-3, "s": 1.0, "m": 60.0, "h": 3600.0}
_TRUE = {**dict.fromkeys(("true", "yes", "y", "on"), True), **dict.fromkeys(("false", "no", "n", "off"), False)}


def size(text: str) -> int:
    """Bytes of `512`, `50M`, `1.5gb`, `64 KiB`: all units are powers of 1024, as in Compose. Raises ValueError."""
    found = _SIZE.match(text.strip())
    if not found:
        raise ValueError(f"'{text}' is not an amount of memory")
    return int(Decimal(found[1]) * 1024 ** _POWERS[found[2].lower()])


def duration(text: str) -> float:
    """Seconds of `90s`, `1m30s`, `1h`. Raises ValueError."""
    total, at = 0.0, 0
    for found in _DURATION.finditer(text):
        if found.start() != at or found[2] not in _SECONDS:
            break
        total, at = total + float(found[1]) * _SECONDS[found[2]], found.end()
    if text == "0":
        return 0.0
    if not text or at != len(text):
        raise ValueError(f"'{text}' is not a duration")
    return round(total, 9)


def boolean(text: str) -> bool:
    """Raises ValueError."""
    try:
        return _TRUE[text.lower()]
    except KeyError:
        raise ValueError(f"'{text}' is neither true nor false") from None


def integer(text: str) -> int:
    """Raises ValueError for all but decimal digits with a sign."""
    if not re.fullmatch(r"[-+]?[0-9]{1,19}", text):
        raise ValueError(f"'{text}' is not a whole number")
    return int(text)


def number(text: str) -> float:
    """Raises ValueError."""
    try:
        return float(Decimal(text))
    except (InvalidOperation, ValueError, OverflowError):
        raise ValueError(f"'{text}' is not a number") from None


def shown(value: object) -> str:
    """A scalar as Compose makes text of it: true, 5, 1.5, and no point in a float that is whole."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return _float(value)
    return str(value)


def _float(value: float) -> str:
    text = repr(value)
    mantissa, _, power = text.partition("e")
    exponent = int(power) if power else 0
    if exponent >= 21 or exponent < -5:
        return f"{mantissa.removesuffix('.0')}e{exponent:+03d}"
    if abs(value) < 1e-4 and value:
        mantissa, _, power = f"{value:e}".partition("e")
        return f"{mantissa.rstrip('0').rstrip('.')}e{int(power):+03d}"
    return format(Decimal(text), "f").removesuffix(".0")
