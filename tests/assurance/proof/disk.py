"""What a loss of power leaves of the files that rorg wrote, after the model of ALICE (Pillai et al., OSDI 2014).

The disk has everything that an fsync secured. Of the operations since then it may have any: contents without their
name, a new name without its contents, a removal without the rename before it. A file's fsync secures its contents, a
directory's fsync its names.
"""

from __future__ import annotations

import contextlib
import io
import os
import random
import shutil
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import count

OPEN, RENAME, UNLINK, MKDIR, TRUNCATE = io.open, os.rename, os.unlink, os.mkdir, os.truncate
"""Without counting."""
MOST_OPERATIONS = 12
"""Operations without fsync that are looked at, the last ones; the disk has the earlier ones."""
MOST_OUTCOMES = 8
"""Outcomes that are tried at a point. If there are more, the number of the point draws them."""
FOLDER = 0
"""Stands for a directory among the contents of names."""
State = dict[str, "bytes | int | None"]
"""Path -> what the disk has there: contents, FOLDER, or None for nothing."""


@dataclass(frozen=True)
class Operation:
    """Writes `contents` of a file, or changes names of a directory."""

    folder: int
    """The number (inode) of the directory whose fsync secures it; 0 if it writes contents."""
    names: tuple[tuple[str, int | None], ...] = ()
    """Path -> file; None if the name goes."""
    file: int = FOLDER
    contents: bytes = b""
    moved: tuple[str, str] | None = None
    """A directory that gets another name."""


class Disk:
    """Is told of each operation right after it, and with keep() of the names that it changes right before it. Any
    thread may tell."""

    def __init__(self) -> None:
        self.log: list[Operation] = []
        self.secured: dict[str, int | None] = {}
        """The file behind each name that an operation without fsync has changed."""
        self.now: dict[str, int | None] = {}
        self.contents: dict[int, bytes] = {}
        """What is secured of each file."""
        self._numbers = count(1)
        self._lock = threading.RLock()

    # -- what is done ----------------------------------------------------------------------------------------------

    def keep(self, *paths: str) -> None:
        """Note what the disk has there before the first change."""
        with self._lock:
            for path in paths:
                if path in self.now:
                    continue
                found: int | None = None
                if os.path.isdir(path) and not os.path.islink(path):
                    found = FOLDER
                elif (there := _read(path)) is not None:
                    found = next(self._numbers)
                    self.contents[found] = there
                self.secured[path] = self.now[path] = found

    def created(self, path: str) -> None:
        with self._lock:
            number = next(self._numbers)
            self.contents[number] = b""
            self._names(os.path.dirname(path), (path, number))

    def made(self, path: str) -> None:
        self._names(os.path.dirname(path), (path, FOLDER))

    def removed(self, path: str) -> None:
        self._names(os.path.dirname(path), (path, None))

    def renamed(self, old: str, new: str) -> None:
        number = self.now.get(old)
        moved = (old, new) if number == FOLDER else None
        self._names(os.path.dirname(new), (old, None), (new, number), moved=moved)

    def wrote(self, path: str) -> None:
        """Its contents are other ones now."""
        with self._lock:
            number, contents = self.now.get(path), _read(path)
            if not number or contents is None:
                return
            if self.log and self.log[-1].file == number:
                self.log.pop()
            self._add(Operation(0, file=number, contents=contents))

    def synced(self, path: str) -> None:
        with self._lock:
            if os.path.isdir(path):
                folder = _number(path)
                self._secure([o for o in self.log if o.folder == folder])
            elif number := self.now.get(path):
                self._secure([o for o in self.log if o.file == number])

    def _names(self, folder: str, *names: tuple[str, int | None], moved: tuple[str, str] | None = None) -> None:
        with self._lock:
            for path, _ in names:
                self.secured.setdefault(path, None)
            _apply(self.now, names, moved)
            self._add(Operation(_number(folder), names, moved=moved))

    def _add(self, operation: Operation) -> None:
        self.log.append(operation)
        self._secure(self.log[:-MOST_OPERATIONS])

    def _secure(self, operations: list[Operation]) -> None:
        for operation in operations:
            self.log.remove(operation)
            if operation.file:
                self.contents[operation.file] = operation.contents
            _apply(self.secured, operation.names, operation.moved)
        if operations:
            self._forget()

    def _forget(self) -> None:
        """Forget what no operation without fsync concerns any more."""
        changed = {path for o in self.log for path, _ in o.names}
        reachable = {n for n in (*self.secured.values(), *self.now.values()) if n}
        reachable |= {n for o in self.log for _, n in o.names if n}
        self.log = [o for o in self.log if not o.file or o.file in reachable]
        written = {o.file for o in self.log if o.file}
        kept = {p for p, n in self.now.items() if p in changed or n in written or self.secured.get(p) in written}
        self.now = {p: n for p, n in self.now.items() if p in kept}
        self.secured = {p: n for p, n in self.secured.items() if p in kept}
        needed = {n for n in (*self.secured.values(), *self.now.values()) if n}
        needed |= {n for o in self.log for _, n in o.names if n} | written
        self.contents = {n: c for n, c in self.contents.items() if n in needed}

    # -- what is left of it ----------------------------------------------------------------------------------------

    def outcomes(self, point: int) -> list[tuple[int, ...]]:
        """Which operations the disk has, in each of the different outcomes: of a first part of them, of one alone, of
        all but one."""
        with self._lock:
            everything = tuple(range(len(self.log)))
            found: dict[str, tuple[int, ...]] = {repr(self.state(everything)): everything}
            for kept in _subsets(len(self.log)):
                found.setdefault(repr(self.state(kept)), kept)
        different = list(found.values())[1:]
        if len(different) <= MOST_OUTCOMES:
            return different
        return random.Random(point).sample(different, MOST_OUTCOMES)

    def state(self, kept: Iterable[int]) -> State:
        """What the disk has of all names that were changed, if it has these operations only."""
        names, contents = dict(self.secured), dict(self.contents)
        for index in kept:
            operation = self.log[index]
            if operation.file:
                contents[operation.file] = operation.contents
            _apply(names, operation.names, operation.moved)
        paths = sorted({*names, *self.now})
        return {p: contents[n] if (n := names.get(p)) else n for p in paths}

    def leave(self, kept: tuple[int, ...]) -> None:
        """Bring the files into this state. Other threads go on meanwhile, until they are killed."""
        for index in reversed(range(len(self.log))):
            moved = self.log[index].moved
            if moved and index not in kept:
                RENAME(moved[1], moved[0])
        for path, content in self.state(kept).items():
            with contextlib.suppress(FileNotFoundError, NotADirectoryError):
                _put(path, content)

    def lose(self) -> None:
        """Lose contents without fsync, and names if their contents have one: a new name without its contents, or the
        old name and contents."""
        written = {o.file for o in self.log if o.file}
        unsynced = {p for p, n in self.now.items() if n in written}
        for path in filter(os.path.isfile, tuple(unsynced)):
            with contextlib.suppress(FileNotFoundError):
                TRUNCATE(path, 0)
        for path, number in tuple(self.secured.items()):
            if path not in unsynced and number != FOLDER and self.now.get(path) != FOLDER:
                _put(path, self.contents[number] if number else None)


def _subsets(size: int) -> Iterator[tuple[int, ...]]:
    everything = range(size)
    for index in everything:
        yield tuple(everything[:index])
        yield (index,)
        yield tuple(n for n in everything if n != index)


def _apply(names: dict[str, int | None], changes: Iterable[tuple[str, int | None]], moved: object) -> None:
    for path, number in changes:
        names[path] = number
    if isinstance(moved, tuple):
        old, new = moved
        for path in [p for p in names if p.startswith(f"{old}/")]:
            names[new + path[len(old) :]] = names[path]
            names[path] = None


def _put(path: str, content: bytes | int | None) -> None:
    if isinstance(content, int):
        if not os.path.isdir(path):
            MKDIR(path)
    elif content is None:
        if os.path.isdir(path) and not os.path.islink(path):
            shutil.rmtree(path, ignore_errors=True)
        elif os.path.lexists(path):
            UNLINK(path)
    elif _read(path) != content:
        with OPEN(path, "wb") as file:
            file.write(content)


def _read(path: str) -> bytes | None:
    try:
        with OPEN(path, "rb") as file:
            return file.read()
    except OSError:
        return None


def _number(folder: str) -> int:
    try:
        return os.stat(folder).st_ino
    except OSError:
        return -1
