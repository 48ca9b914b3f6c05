"""Secrets in the labels of a container: a label tells two values apart and holds neither.

A secret is written as `***(HASH)`. Equal secrets have equal marks, so rorg can still compare a container with what is
declared, and declaring a value secret replaces no container. The hash hides a long secret only: a person who may read
the labels of the engine can find a short one by trying all. masking.py decides what people see.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import Any

from rorg.core.masking import MARK, MASK
from rorg.model.catalog import SHORTEST_SECRET

READ_BACK = ("image", "container_name", "volumes", "stop_signal", "stop_grace_period")
"""Options that rorg reads back from a container's label, so they are stored unmasked."""


def marked(option: str, value: Any, values: Iterable[str]) -> Any:
    """Return an option for a container's label, with secrets replaced by marks."""
    marks = [(v, f"{MASK}({_hash(v)})") for v in sorted(values, key=len, reverse=True) if len(v) >= SHORTEST_SECRET]
    return _marked(value, marks) if marks and option not in READ_BACK else value


def _marked(value: Any, marks: list[tuple[str, str]]) -> Any:
    if isinstance(value, str):
        for secret, mark in marks:
            value = value.replace(secret, mark)
        return value
    if isinstance(value, dict):
        return {key: _marked(item, marks) for key, item in value.items()}
    return [_marked(item, marks) for item in value] if isinstance(value, list) else value


def same(a: Any, b: Any) -> bool:
    """Return whether two options are equal, comparing marks with the plain text they stand for. So declaring a value
    secret, or no longer secret, replaces no container."""
    if isinstance(a, str) and isinstance(b, str):
        return a == b or _stands_for(a, b) or _stands_for(b, a)
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(same, a, b))
    return bool(a == b)


def _stands_for(with_marks: str, plain: str) -> bool:
    prefix, *rest = MARK.split(with_marks)
    if len(rest) != 2 or len(plain) < len(prefix) + len(rest[1]):
        return False
    secret = plain.removeprefix(prefix).removesuffix(rest[1])
    return plain == prefix + secret + rest[1] and _hash(secret) == rest[0]


def _hash(value: str) -> str:
    return hashlib.sha256(value.encode()).hexdigest()[:12]
