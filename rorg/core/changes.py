"""Fast comparison of large collections in which almost every element is the same object as before, so that a pass over
hundreds of unchanged services is cheap."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import chain, compress
from operator import is_not
from typing import Any, TypeVar

K = TypeVar("K")
T = TypeVar("T")
SLICE = 64
"""Items that are compared at once."""
KEPT = 24
"""Steps that a Version keeps: two passes make fewer."""


class Version(dict[K, T]):
    """A mapping that knows by which keys it differs from the versions that it comes from, so that comparing them costs
    no more than what changed. Nobody may change it; updated() makes the next version."""

    __slots__ = ("mark", "steps")
    mark: object
    """Stands for this version in the steps of later ones, which need not keep it in memory."""
    steps: tuple[tuple[object, Collection[K]], ...]
    """(mark of a version before, keys that changed after it), the oldest first."""


def updated(before: Mapping[K, T], changes: Mapping[K, T], gone: Collection[K] = ()) -> Version[K, T]:
    """Return the next version of a mapping: with these changes, and without the keys that are gone."""
    version = Version(before)
    for key in gone:
        del version[key]
    version.update(changes)
    version.mark = object()
    steps, mark = (before.steps, before.mark) if isinstance(before, Version) else ((), None)
    version.steps = (*steps[1 - KEPT :], (mark, (*gone, *changes)))
    return version


def changed_keys(before: Mapping[K, Any], now: Mapping[K, Any]) -> set[K]:
    """Return keys whose value is a different object than before, including new keys but not removed ones."""
    if before is now:
        return set()
    if isinstance(now, Version) and isinstance(before, Version):
        marks = [mark for mark, _ in now.steps]
        if before.mark in marks:
            keys = chain.from_iterable(keys for _, keys in now.steps[marks.index(before.mark) :])
            return {key for key in keys if key in now and before.get(key) is not now[key]}
    if [*before] == [*now]:  # the same keys in the same order
        return set(compress(now, map(is_not, before.values(), now.values())))
    return {key for key, value in now.items() if before.get(key) is not value}


def differing(before: Mapping[K, Any], now: Mapping[K, Any]) -> set[K]:
    """Return keys with another value than before, and those that only one of the two has."""
    if before is now:
        return set()
    return {key for key in before.keys() | now.keys() if before.get(key) != now.get(key)}


def changed_items(before: Sequence[T], now: Sequence[T]) -> tuple[list[T], list[T]]:
    """Return the items that went and those that came. If the order changed, an item may be in both. An item that equals
    the one in its place may be left out."""
    if before is now:
        return [], []
    if len(before) == len(now):
        return _differing(before, now)
    least = min(len(before), len(now))
    if before[:least] == now[:least]:
        return [*before[least:]], [*now[least:]]
    then, there = set(map(id, before)), set(map(id, now))
    return [x for x in before if id(x) not in there], [x for x in now if id(x) not in then]


def _differing(before: Sequence[T], now: Sequence[T]) -> tuple[list[T], list[T]]:
    """Return the items that are not the same in both, by place. Slices are compared first, because comparing the same
    objects in a row costs next to nothing."""
    went, came = list[T](), list[T]()
    for at in range(0, len(now), SLICE):
        one, other = before[at : at + SLICE], now[at : at + SLICE]
        if one != other:
            moved = list(map(is_not, one, other))
            went += compress(one, moved)
            came += compress(other, moved)
    return went, came
