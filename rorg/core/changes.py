"""Fast comparison of large collections in which almost every element is the same object as before. Comparing identities
instead of values keeps a pass over hundreds of unchanged services cheap."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import compress
from operator import is_not
from typing import Any, TypeVar

K = TypeVar("K")
T = TypeVar("T")


def changed_keys(before: Mapping[K, Any], now: Mapping[K, Any]) -> set[K]:
    """Return keys whose value is a different object than before, including new keys but not removed ones."""
    if before is now:
        return set()
    if [*before] == [*now]:  # the same keys in the same order
        return set(compress(now, map(is_not, before.values(), now.values())))
    return {key for key, value in now.items() if before.get(key) is not value}


def differing(before: Mapping[K, Any], now: Mapping[K, Any]) -> set[K]:
    """Return keys with another value than before, and those that only one of the two has."""
    if before is now:
        return set()
    return {key for key in before.keys() | now.keys() if before.get(key) != now.get(key)}


def changed_items(before: Sequence[T], now: Sequence[T]) -> tuple[list[T], list[T]]:
    """Return the items that went and those that came, by identity. If the order changed, an item may be in both."""
    if before is now:
        return [], []
    least = min(len(before), len(now))
    moved = list(map(is_not, before, now))
    if len(before) == len(now) or not any(moved):
        return [*compress(before, moved), *before[least:]], [*compress(now, moved), *now[least:]]
    then, there = set(map(id, before)), set(map(id, now))
    return [x for x in before if id(x) not in there], [x for x in now if id(x) not in then]
