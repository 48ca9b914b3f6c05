"""Drops keys and items of lists from a document, so that what is left can be checked."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from rorg.manifest.yaml_source import Document, Path

V = TypeVar("V")


def without(value: Any, paths: Iterable[Path]) -> Any:
    """A copy without the keys and items at these paths."""
    below: dict[str | int, list[Path]] = {}
    for first, *rest in paths:
        below.setdefault(first, []).append(tuple(rest))
    if not below or not isinstance(value, dict | list):
        return value
    inside = value.items() if isinstance(value, dict) else enumerate(value)
    kept = ((key, without(one, below.get(key, ()))) for key, one in inside if () not in below.get(key, ()))
    return dict(kept) if isinstance(value, dict) else [one for _, one in kept]


@dataclass(frozen=True)
class Shift:
    """How the paths of a document change when items of its lists are dropped."""

    gone: Mapping[Path, list[int]]
    """List -> the sorted indices of its dropped items."""

    @staticmethod
    def of(dropped: Iterable[Path]) -> Shift:
        gone: dict[Path, list[int]] = {}
        for *above, last in sorted((p for p in dropped if isinstance(p[-1], int)), key=lambda p: p[-1]):
            gone.setdefault(tuple(above), []).append(int(last))
        return Shift(gone)

    def path(self, path: Path) -> Path | None:
        """The new path; None if it was dropped."""
        moved = list(path)
        for at, part in enumerate(path):
            gone = self.gone.get(path[:at]) if isinstance(part, int) else None
            if gone and isinstance(part, int):
                before = bisect_left(gone, part)
                if gone[before : before + 1] == [part]:
                    return None
                moved[at] = part - before
        return tuple(moved)

    def paths(self, paths: Iterable[Path]) -> set[Path]:
        return {moved for path in paths if (moved := self.path(path)) is not None}

    def keys(self, entries: Mapping[Path, V]) -> dict[Path, V]:
        return {moved: value for path, value in entries.items() if (moved := self.path(path)) is not None}


def without_items(document: Document, items: Collection[Path]) -> Document:
    """The document without these items of lists; those behind them move up."""
    if not items:
        return document
    shift, value = Shift.of(items), without(document.value, items)
    keys, values = shift.keys(document.keys), shift.keys(document.values)
    filled, files = shift.keys(document.filled), shift.keys(document.files)
    return replace(document, value=value, keys=keys, values=values, filled=filled, files=files)
