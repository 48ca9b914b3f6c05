"""Writes plain values as YAML for people: block style, short lists on one line, comments beside values."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

WIDTH = 110
"""Characters of a line; a longer list gets one line per item."""
SHORT = 3
"""Entries of a mapping that fit on one line."""
_PLAIN = re.compile(
    r"(?:[A-Za-z_/]|\.{1,2}/|--?[A-Za-z])(?:[A-Za-z0-9_./@+=~-]|:(?=[A-Za-z0-9_./]))*|"
    r"[0-9]+(?:\.[0-9]+)?(?:ms|s|m|h|d|Ki|Mi|Gi)"
)
_WORDS = re.compile(r"[A-Za-z_][A-Za-z0-9_./@+=~() -]*[A-Za-z0-9_./)]")
_TAKEN = frozenset(("true", "false", "null", "yes", "no", "on", "off", "y", "n", "~"))
"""Words that other YAML readers do not read as text."""
_CONTROL = re.compile(
    "[^\\x20-\\x7e\\xa0-\\ud7ff\\ue000-\\ufefe\\uff00-\\ufffd\\U00010000-\\U0010ffff]|[\\u2028\\u2029]"
)


@dataclass(frozen=True)
class Noted:
    """A value with a comment at the end of its line."""

    value: Any
    comment: str


@dataclass(frozen=True)
class Inline:
    """A mapping on one line, if it fits."""

    value: Mapping[str, Any]


def plain(value: Any) -> Any:
    """The value without comments."""
    if isinstance(value, Noted | Inline):
        return plain(value.value)
    if isinstance(value, Mapping):
        return {key: plain(item) for key, item in value.items()}
    return [plain(item) for item in value] if isinstance(value, list | tuple) else value


def yaml_text(value: Mapping[str, Any]) -> str:
    """A whole document; YAML 1.2 reads the same value from it."""
    return "".join(f"{line}\n" for line in _mapping(value))


def scalar(value: Any) -> str:
    """Writes a text, number, boolean or null on one line."""
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if not isinstance(value, str):
        return repr(value)
    sound = (_PLAIN.fullmatch(value) or _WORDS.fullmatch(value)) and value.lower() not in _TAKEN
    return value if sound else _quoted(value)


def _quoted(text: str) -> str:
    """Quotes a text. Characters that must not be in a file are escaped, numerically if JSON has no escape for them."""
    quoted = json.dumps(text, ensure_ascii=False)
    return _CONTROL.sub(lambda m: f"\\u{ord(m[0]):04x}" if ord(m[0]) > 0xFF else f"\\x{ord(m[0]):02x}", quoted)


def _mapping(value: Mapping[str, Any]) -> list[str]:
    lines: list[str] = []
    for key, item in value.items():
        lines += _entry(f"{scalar(key)}:", item)
    return lines


def _entry(head: str, item: Any) -> list[str]:
    """Writes `head` with its value behind or below it."""
    item, comment = (item.value, f"   # {one_line(item.comment)}") if isinstance(item, Noted) else (item, "")
    if head == "-" and isinstance(item, Mapping):
        item = Inline(item)
    inline = _flow(item) if not isinstance(item, Mapping) or not item else ""
    if isinstance(item, Inline):
        inline, item = _flow(item.value), item.value
    if inline and len(head) + len(inline) <= WIDTH and "\n" not in _texts(item):
        return [f"{head} {inline}{comment}"]
    if isinstance(item, Mapping):
        return [f"{head}{comment}", *(f"  {line}" if line else "" for line in _mapping(item))]
    if isinstance(item, str):
        return _text(head, item, comment)
    below = (line for one in item for line in _entry("-", one))
    return [f"{head}{comment}", *(f"  {line}" if line else "" for line in below)]


def _flow(value: Any) -> str:
    """Writes a value on one line; empty if it contains comments."""
    if isinstance(value, Noted):
        return ""
    if isinstance(value, Inline):
        return _flow(value.value)
    if isinstance(value, Mapping):
        parts = [(scalar(k), _flow(v)) for k, v in value.items()]
        return "" if any(not v for _, v in parts) else "{" + ", ".join(f"{k}: {v}" for k, v in parts) + "}"
    if isinstance(value, list | tuple):
        items = ["" if _deep(item) else _flow(item) for item in value]
        return "" if any(not item for item in items) else "[" + ", ".join(items) + "]"
    return scalar(value)


def _deep(item: Any) -> bool:
    """Whether this is a mapping of mappings, which needs a line of its own to be readable."""
    inner = item.value if isinstance(item, Inline) else item
    return isinstance(inner, Mapping) and any(isinstance(v, Mapping) for v in inner.values())


def _texts(value: Any) -> str:
    """All text in a value, to search it for line breaks."""
    if isinstance(value, Mapping):
        return "".join(_texts(item) for item in value.values())
    if isinstance(value, list | tuple):
        return "".join(map(_texts, value))
    return value if isinstance(value, str) else ""


def _text(head: str, text: str, comment: str) -> list[str]:
    """Writes a long text, as a block if a block can hold its lines."""
    lines = text.removesuffix("\n").split("\n")
    sound = lines[0] and not lines[0].startswith(" ") and lines[-1] and not text.endswith("\n\n")
    if (
        len(lines) < 2
        or not sound
        or _CONTROL.search(text.replace("\n", ""))
        or any(line != line.rstrip() for line in lines)
    ):
        return [f"{head} {_quoted(text)}{comment}"]
    sign = "|" if text.endswith("\n") else "|-"
    return [f"{head} {sign}{comment}", *(f"  {line}" if line else "" for line in lines)]


def one_line(text: str) -> str:
    """The text on one line, as a comment."""
    return _CONTROL.sub(" ", " ".join(text.split()))
