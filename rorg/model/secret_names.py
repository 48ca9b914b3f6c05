"""Which names say that what they stand for is secret."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from typing import Any

_PART = r"passw(?:or)?d|passphrase|secret|token|credential|api[-_]?key|access[-_]?key|private[-_]?key"
NAME = rf"(?=[\w.-]*?(?:{_PART}))[\w.-]*+"
"""Without regard to the case of letters. To be looked for where a word begins: it takes time linear in the word."""
_NAME = re.compile(NAME, re.IGNORECASE)


def is_secret_name(name: str) -> bool:
    """Of a variable, an option or a field."""
    return _NAME.fullmatch(name) is not None


def secret_texts(name: str, value: Any) -> Iterator[str]:
    """All texts in a plain JSON value that stand under such a name; of a path, such as a name of ROS, its last part
    counts. `name` is that of the value itself."""
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from secret_texts(name if is_secret_name(name) else key.rpartition("/")[2], item)
    elif isinstance(value, list):
        for item in value:
            yield from secret_texts(name, item)
    elif isinstance(value, str) and is_secret_name(name):
        yield value
