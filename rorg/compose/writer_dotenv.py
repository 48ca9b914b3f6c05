"""Variables as a file of `env_file`, in the form that Compose reads."""

from __future__ import annotations

import re
from collections.abc import Mapping

_PLAIN = re.compile(r"[A-Za-z0-9_./:@%+,=-]*")
_ESCAPES = {"\\": "\\\\", '"': '\\"', "$": "\\$", "\n": "\\n", "\r": "\\r", "\t": "\\t"}


def dotenv(values: Mapping[str, str]) -> str:
    """A line for each. What has quotes, spaces or signs of its own is quoted so that it is read as it is."""
    return "".join(f"{name}={_quoted(value)}\n" for name, value in sorted(values.items()))


def _quoted(value: str) -> str:
    if _PLAIN.fullmatch(value):
        return value
    if "'" not in value and "\n" not in value and "\r" not in value and "\\" not in value:
        return f"'{value}'"
    return '"' + "".join(_ESCAPES.get(sign, sign) for sign in value) + '"'
