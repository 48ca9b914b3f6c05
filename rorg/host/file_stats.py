"""What tells that files have changed without reading them: which there are, and the time, size and inode of each."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

Stats = tuple[tuple[str | int, ...], ...]
"""Of files: name, time, size and inode."""
MOST_CONTEXT_FILES = 20_000
"""Of all contexts together that are looked at for changes; a change behind them is seen with the next one before."""


def below(places: Iterable[Path]) -> Iterator[Path]:
    """Files and directories, and all that is in these."""
    for place in places:
        yield place
        for folder, folders, files in os.walk(place):
            folders[:] = sorted(f for f in folders if not f.startswith("."))
            yield from (Path(folder, name) for name in (*folders, *sorted(files)))


def contexts(places: Iterable[Path]) -> Iterator[Path]:
    """What images are built from, as far as it can be watched; version control is no part of it."""
    return itertools.islice((path for place in sorted(places) for path in _context(place)), MOST_CONTEXT_FILES)


def _context(place: Path) -> Iterator[Path]:
    yield place
    for folder, folders, files in os.walk(place):
        folders[:] = sorted(f for f in folders if not (f == ".git" and folder == str(place)))
        yield from (Path(folder, name) for name in (*folders, *sorted(files)))


def stats(paths: Iterable[Path]) -> Stats:
    """Of those that are there."""
    found = []
    for path in paths:
        try:
            # A link that leads nowhere is of the tree too.
            stat = os.stat(path) if os.path.exists(path) else os.lstat(path)
        except OSError:
            continue
        found.append((str(path), stat.st_mtime_ns, stat.st_size, stat.st_ino))
    return tuple(found)
