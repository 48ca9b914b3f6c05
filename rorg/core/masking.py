"""What may be shown of declared values: whatever may be secret is masked. This is the only rule of it."""

from __future__ import annotations

import re
from typing import Any

MASK = "***"
_NAME = r"[\w.-]*(?:passw(?:or)?d|passphrase|secret|token|credential|api[-_]?key|access[-_]?key|private[-_]?key)[\w.-]*"
_VALUE = r"(?:\"[^\"]*\"|'[^']*'|[^\s'\"]\S*)"
_SECRET_NAME = re.compile(_NAME, re.IGNORECASE)
_SHORT = {r"(?:mysql|mariadb)[\w-]*|sshpass": "-p", r"redis-cli": "-a", r"curl": "-u"}
"""Programs, and their option of one letter that takes a secret, with or without a space. Of others `-p` is a port."""
_RULES = (
    (re.compile(r"(\b(?:bearer|basic)\s+)\S+", re.IGNORECASE), rf"\1{MASK}"),
    (re.compile(r"(://[^\s:/@]*:)[^\s@/]+@"), rf"\1{MASK}@"),
    # NAME=value, NAME:=value (roslaunch), "NAME: value" (a header); a colon alone also parts the paths of a mount.
    (re.compile(rf"({_NAME}(?::?=|:\s)\s*){_VALUE}", re.IGNORECASE), rf"\1{MASK}"),
    (re.compile(rf"((?:^|\s)--?{_NAME}\s+){_VALUE}", re.IGNORECASE), rf"\1{MASK}"),
    *(
        (re.compile(rf"((?:^|[\s/])(?:{programs})\s(?:[^;|&\n]*?\s)?{option}\s*){_VALUE}"), rf"\1{MASK}")
        for programs, option in _SHORT.items()
    ),
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
    words = [item for item in items if isinstance(item, str)]
    short = tuple(o for p, o in _SHORT.items() if any(re.fullmatch(p, w.rpartition("/")[2]) for w in words))

    def shown(name: Any, item: Any) -> Any:
        if isinstance(name, str) and name.startswith("-") and (name in short or _SECRET_NAME.fullmatch(name)):
            return MASK
        if isinstance(item, str) and item.startswith(short) and item not in short:
            return item[:2] + MASK
        return masked("", item)

    return [shown(name, item) for name, item in zip([None, *items], items, strict=False)]
