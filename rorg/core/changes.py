"""What differs between what is kept and what is there now, found fast where most is the same object as before."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import compress
from operator import is_not
from typing import Any, TypeVar

K = TypeVar("K")
T = TypeVar("T")


def changed_keys(before: Mapping[K, Any], now: Mapping[K, Any]) -> set[K]:
    """Keys whose values are other objects than before, new ones included; not those that are gone."""
    if before is now:
        return set()
    if len(before) == len(now) and not any(map(is_not, before, now)):
        return set(compress(now, map(is_not, before.values(), now.values())))
    return {key for key, value in now.items() if before.get(key) is not value}


def changed_items(before: Sequence[T], now: Sequence[T]) -> list[T]:
    """What is only in one of the two, by identity; perhaps some of what is in both, where the order is another."""
    if before is now:
        return []
    least = min(len(before), len(now))
    moved = list(map(is_not, before, now))
    if len(before) == len(now) or not any(moved):
        return [*compress(before, moved), *compress(now, moved), *before[least:], *now[least:]]
    then, there = set(map(id, before)), set(map(id, now))
    return [*(x for x in now if id(x) not in then), *(x for x in before if id(x) not in there)]
