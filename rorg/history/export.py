"""The forms of the export. All of them say the same; an empty list is no list to protocol buffers."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from rorg.history.protobuf import record


def line(value: Mapping[str, Any]) -> bytes:
    """A record as a line of JSON."""
    return json.dumps(value).encode() + b"\n"


ENCODERS: Mapping[str, Callable[[Mapping[str, Any]], bytes]] = {"jsonl": line, "protobuf": record}
"""By the name of a form."""
