"""Every kind of event that rorg writes is one that `rorg events --kind` knows, and the other way round."""

from __future__ import annotations

import ast
from collections.abc import Iterator

from common import ROOT

from rorg.model.event_kinds import EVENT_KINDS

PLACES = {"event": 0, "tell": 0, "_note": 0, "_write": 0, "Change": 1, "when_new": 2}
"""Functions that take a kind, and the place of it among their arguments."""
ROOMS = ("api", "daemon", "history")
OTHERS = {"git", "git-refused", "git-submodules", "git-unreachable", "image-failed", "image-ready"}
"""Kinds that get there as a value."""


def texts(node: ast.expr) -> Iterator[str]:
    if isinstance(node, ast.IfExp):
        yield from (*texts(node.body), *texts(node.orelse))
    elif isinstance(node, ast.Constant) and isinstance(node.value, str):
        yield node.value


def written() -> set[str]:
    """The kinds in calls with at least two arguments: a kind and a message."""
    files = (path for room in ROOMS for path in (ROOT / "rorg" / room).rglob("*.py"))
    calls = (n for path in files for n in ast.walk(ast.parse(path.read_text())) if isinstance(n, ast.Call))
    found: set[str] = set()
    for call in calls:
        place = PLACES.get(getattr(call.func, "attr", "") or getattr(call.func, "id", ""))
        if place is not None and len(call.args) > max(place, 1):
            found.update(texts(call.args[place]))
    return found


def test_the_list_of_kinds_is_complete():
    assert written() | OTHERS == set(EVENT_KINDS)
    assert sorted(EVENT_KINDS) == list(EVENT_KINDS)
