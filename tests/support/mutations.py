"""Mutations of text and of values, from a seed: what an editor, a merge, a disk or an attacker make of a file."""

from __future__ import annotations

import copy
import random
from collections.abc import Callable
from typing import Any

WORDS = (
    "", " ", "\t", "\n", "\0", "-", "- ", ": ", "{", "}", "[", "]", "&a ", "*a", "<<: ", "!!python/object:x ",
    "!!binary ", "|",
    ">", "'", '"', "#", "%", "@", "`", "? ", "null", "~", "true", ".inf", "-.inf", ".nan", "1e400", "9" * 400,
    "-" * 50, "0x", "0o9", "1_0", "2026-01-01", "é", "\u202e", "\ufeff", "\x85", "\ud7ff", "(" * 120, "${", "${A", "$$",
    "../" * 40, "a" * 5000, "/" * 300, "*", "1ms", "0s", "1e9d", "-1s", "999999999999999999d", "180Mi", "1e99Gi",
)  # fmt: skip
VALUES: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 10**400, 2**63, 1.5, float("inf"), float("-inf"), float("nan"), "", " ", "\0",
    "a" * 5000, "(" * 120,
    "../../..", "/", "~", [], {}, [[]], [{}], {"a": {}}, {1: 2}, {None: None}, {True: []}, [None], ["\0"],
    "99999999999999999999s", "1e400", "0.0001ms", "180Xi", "*", "developer", "${A:?}", {"a" * 300: "b"}, ["a"] * 500,
)  # fmt: skip


def mutated_text(text: str, chance: random.Random) -> str:
    """The text with one to four places changed."""
    for _ in range(chance.randint(1, 4)):
        at = chance.randint(0, len(text))
        end = min(len(text), at + chance.choice((0, 0, 1, 3, 10, 40)))
        what = chance.random()
        if what < 0.6:
            text = text[:at] + chance.choice(WORDS) + text[end:]
        elif what < 0.8:
            text = text[:at] + text[end:]
        else:
            start = chance.randint(0, len(text))
            text = text[:at] + text[start : start + chance.randint(1, 80)] + text[at:]
    return text


def mutated_value(value: Any, chance: random.Random) -> Any:
    """A document's value with one part of it replaced, or doubled under another key."""
    places: list[Callable[[Any], None]] = []

    def visit(node: Any) -> None:
        keys = list(node) if isinstance(node, dict) else list(range(len(node))) if isinstance(node, list) else []
        for key in keys:
            places.append(lambda new, node=node, key=key: node.__setitem__(key, new))
            visit(node[key])
        if isinstance(node, dict):
            places.append(lambda new, node=node: node.__setitem__(chance.choice(("a", "id", "services", 1, None)), new))

    visit(value)
    if places:
        chance.choice(places)(copy.deepcopy(chance.choice(VALUES)))
    return value
