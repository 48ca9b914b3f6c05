"""Bounds of what another machine sends. It may be broken or hostile, so nothing of a message counts that the disk, the
journal or another machine could not take."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from typing import TypeVar

BITS = 64
"""Of an integer, with its sign."""
MOST_CHARACTERS = 10_000
"""Of a text."""
MOST_ITEMS = 10_000
"""Of a list or a mapping."""
LONGEST_REASON = 1_000
"""Characters of a reason that this machine sends."""
T = TypeVar("T")


def within_bounds(value: T) -> T:
    """Return a typed value of a message, made of dataclasses, tuples, mappings, texts and numbers; its types bound how
    deep it is. Raises ValueError."""
    if why := _excess(value):
        raise ValueError(why)
    for part in _parts(value):
        within_bounds(part)
    return value


def is_within_bounds(value: object) -> bool:
    """Return whether a value may be in a message."""
    try:
        within_bounds(value)
    except ValueError:
        return False
    return True


def _excess(value: object) -> str:
    match value:
        case int() if value.bit_length() >= BITS:
            return f"an integer has more than {BITS} bits"
        case float() if not math.isfinite(value):
            return "a number is not finite"
        case str() if len(value) > MOST_CHARACTERS:
            return f"a text has more than {MOST_CHARACTERS} characters"
        case tuple() | Mapping() if len(value) > MOST_ITEMS:
            return f"a list has more than {MOST_ITEMS} items"
    return ""


def _parts(value: object) -> Iterable[object]:
    if isinstance(value, Mapping):
        return (*value.keys(), *value.values())
    if is_dataclass(value):
        return (getattr(value, field.name) for field in fields(value))
    return value if isinstance(value, tuple) else ()
