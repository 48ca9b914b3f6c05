"""Recognizes names of secret values."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

_PART = r"passw(?:or)?d|passphrase|secret|token|credential|api[-_]?key|access[-_]?key|private[-_]?key"
NAME = rf"(?=[\w.-]*?(?:{_PART}))[\w.-]*+"
"""Ignores case. Search for it at the start of words: it takes time linear in the word."""
_NAME = re.compile(NAME, re.IGNORECASE)


def is_secret_name(name: str) -> bool:
    """Whether a variable, option or field with this name is secret."""
    return _NAME.fullmatch(name) is not None


def secret_texts(name: str, value: Any) -> Iterator[str]:
    """All texts below secret names in a plain JSON value. Of a path, such as a ROS name, the last part counts. `name`
    is the name of the value itself."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from secret_texts(name if is_secret_name(name) else key.rpartition("/")[2], item)
    elif isinstance(value, list):
        for item in value:
            yield from secret_texts(name, item)
    elif isinstance(value, str) and is_secret_name(name):
        yield value
