"""Combines entries that repeat, so that a service that fails all day has one line."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

TIMES = re.compile(r"\b[0-9]+(\.[0-9]+)? (ms|s|m|h)\b")
"""How long something took, or takes."""
WINDOW = 12
"""Lines that an entry is compared with."""


class Folded(NamedTuple):
    """Entries that say the same."""

    last: Mapping[str, Any]
    times: int
    since: str
    """When the first of them happened."""


def folded(entries: Iterable[Mapping[str, Any]], window: int = WINDOW) -> list[Folded]:
    """Combine entries that are the same as one of the last `window` lines, except for times and counts, in the place of
    the later one."""
    near: dict[tuple[str, ...], Folded] = {}
    lines: list[Folded] = []
    for entry in entries:
        key = _said(entry)
        before = near.pop(key, None)
        near[key] = Folded(entry, before.times + 1, before.since) if before else Folded(entry, 1, entry["at"])
        if len(near) > window:
            lines.append(near.pop(next(iter(near))))
    return [*lines, *near.values()]


def _said(entry: Mapping[str, Any]) -> tuple[str, ...]:
    text = TIMES.sub("_", entry["message"])
    if "crashes" in entry:  # the message has it after the exit code, which may be the same number
        head, _, tail = text.rpartition(str(entry["crashes"]))
        text = f"{head}_{tail}"
    return str(entry["kind"]), str(entry.get("service") or ""), text
