"""What may be shown of declared values: whatever may be secret is masked. This is the only rule of it."""

from __future__ import annotations

import re
from typing import Any

MASK = "***"
_NAME = r"[\w.-]*(?:passw(?:or)?d|passphrase|secret|token|credential|api[-_]?key|access[-_]?key|private[-_]?key)[\w.-]*"
_VALUE = r"(?:\"[^\"]*\"|'[^']*'|[^\s'\"]\S*)"
_SECRET_NAME = re.compile(_NAME, re.IGNORECASE)
_RULES = (
    (re.compile(r"(\b(?:bearer|basic)\s+)\S+", re.IGNORECASE), rf"\1{MASK}"),
    (re.compile(r"(://[^\s:/@]*:)[^\s@/]+@"), rf"\1{MASK}@"),
    # NAME=value, NAME:=value (roslaunch), "NAME: value" (a header); a colon alone also parts the paths of a mount.
    (re.compile(rf"({_NAME}(?::?=|:\s)\s*){_VALUE}", re.IGNORECASE), rf"\1{MASK}"),
    (re.compile(rf"((?:^|\s)--?{_NAME}\s+){_VALUE}", re.IGNORECASE), rf"\1{MASK}"),
)


def masked(field: str, value: Any) -> Any:
    """The value of a declared field as it may be shown. Environments are shown by name alone."""
    if value is None:
        return None
    if field.partition(".")[0] == "environment" or _SECRET_NAME.fullmatch(field):
        return MASK
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, dict):
        return {key: masked(str(key), item) for key, item in value.items()}
    return _list(value) if isinstance(value, list) else value


def _text(text: str) -> str:
    for pattern, put in _RULES:
        text = pattern.sub(put, text)
    return text


def _list(items: list[Any]) -> list[Any]:
    """What follows the name of a secret option is its value."""
    before = [None, *items]
    return [
        MASK if isinstance(name, str) and name.startswith("-") and _SECRET_NAME.fullmatch(name) else masked("", item)
        for name, item in zip(before, items, strict=False)
    ]
