"""Detects changes of files: by what stat says of them, and by digests of their content, which also show a revert."""

from __future__ import annotations

import hashlib
import itertools
import os
import stat
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

from rorg.model.catalog import Catalog, Spec
from rorg.model.volumes import OF_TREE, SINGLE_FILE

MOST_FILES = 5000
MOST_BYTES = 64 << 20
"""Of one mount. A larger one is data, not configuration: its changes are the service's own business."""
Facts = tuple[int, int, int, int]
Known = dict[str, tuple[Facts, str]]
Stats = tuple[tuple[str | int, ...], ...]
"""Of files: name, time, size and inode."""
MOST_CONTEXT_FILES = 20_000
"""Files of all image contexts together that are checked for changes. Changes of later files are found with the next
change of these."""


class Contents:
    """Digests of the files that services mount. Remembers them by what stat says, so that only changed files are read
    again."""

    def __init__(self) -> None:
        self.files = FileDigests()

    def of(self, catalog: Catalog, root: Path) -> dict[str, dict[str, str]]:
        """Service -> path below the tree -> digest of what is there. Services with `on_change: none` are left out: such
        files are data, which may change all the time."""
        base, digests, mounts = str(root.resolve()), dict[str, dict[str, str]](), dict[str, str]()
        self.files.begin()
        for name, service in catalog.services.items():
            if service.spec is None or service.on_change == "none":
                continue
            for source in mounted(service.spec, base):
                if source not in mounts:
                    mounts[source] = self._digest(source)
            there = {os.path.relpath(s, base): d for s in mounted(service.spec, base) if (d := mounts[s])}
            if there:
                digests[name] = there
        return digests

    def _digest(self, source: str) -> str:
        """ "" if it is too large."""
        files, size = [], 0
        for path, facts in walk(source):
            files.append((path, facts))
            size += facts.st_size
            if len(files) > MOST_FILES or size > MOST_BYTES:
                return ""
        digest = hashlib.sha256()
        for path, facts in sorted(files, key=lambda f: f[0]):
            said = self.files.of(path, facts)
            runs = bool(facts.st_mode & stat.S_IXUSR)
            digest.update(f"{os.path.relpath(path, source)}\0{runs}\0{said}\0".encode(errors="surrogateescape"))
        kind = "" if os.path.isdir(source) else SINGLE_FILE
        return f"{kind}{digest.hexdigest()[:16]}" if files else "empty"


def mounted(spec: Spec, base: str) -> list[str]:
    """Paths below `base` that a container can read but not write. Paths that it can write are its own."""
    sources = []
    for volume in spec.get("volumes", ()):
        if isinstance(volume, Mapping):
            of_host = volume.get("type") in ("bind", OF_TREE)
            source = volume.get("source", "") if of_host and volume.get("read_only") else ""
        else:
            source, _, rest = volume.partition(":")
            source = source if "ro" in rest.partition(":")[2].split(",") else ""
        if source.startswith(f"{base}/"):
            sources.append(os.path.normpath(source))
    return list(dict.fromkeys(sources))


def walk(source: str) -> Iterator[tuple[str, os.stat_result]]:
    """Files and links of a mount that count. Hidden ones belong to editors and version control, not to the service."""
    if not os.path.isdir(source):
        yield from _one(source)
    for folder, folders, files in os.walk(source):
        links = [f for f in folders if os.path.islink(os.path.join(folder, f))]
        folders[:] = [f for f in folders if not f.startswith(".") and f != "__pycache__"]
        for name in (*files, *links):
            if not name.startswith(".") and not name.endswith("~"):
                yield from _one(os.path.join(folder, name))


def _one(path: str) -> Iterator[tuple[str, os.stat_result]]:
    try:
        facts = os.lstat(path)
    except OSError:
        return
    if stat.S_ISREG(facts.st_mode) or stat.S_ISLNK(facts.st_mode):
        yield path, facts


class FileDigests:
    """Between two calls of begin(), of() must be called for every file that matters; the others are forgotten."""

    def __init__(self) -> None:
        self._known: Known = {}
        self._before: Known = {}
        self.read = 0
        """Number of files that were read."""

    def begin(self) -> None:
        self._before, self._known = self._known, {}

    def of(self, path: str, facts: os.stat_result) -> str:
        """Of a link its target, of a regular file 64 hexadecimal digits, of what cannot be read the reason."""
        try:
            return os.readlink(path) if stat.S_ISLNK(facts.st_mode) else self._file(path, facts)
        except OSError as error:
            return f"unreadable: {error.errno}"

    def _file(self, path: str, facts: os.stat_result) -> str:
        key = (facts.st_mtime_ns, facts.st_ctime_ns, facts.st_size, facts.st_ino)
        record = self._known.get(path) or self._before.get(path)
        if record is None or record[0] != key:
            self.read += 1
            descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
            with open(descriptor, "rb") as file:
                record = key, hashlib.file_digest(file, "sha256").hexdigest()
        self._known[path] = record
        return record[1]


def below(places: Iterable[Path]) -> Iterator[Path]:
    """The places, and everything below those that are directories."""
    for place in places:
        yield place
        for folder, folders, files in os.walk(place):
            folders[:] = sorted(f for f in folders if not f.startswith("."))
            yield from (Path(folder, name) for name in (*folders, *sorted(files)))


def contexts(places: Iterable[Path]) -> Iterator[Path]:
    """The files that images are built from, up to MOST_CONTEXT_FILES, without version control."""
    return itertools.islice((path for place in sorted(places) for path in _context(place)), MOST_CONTEXT_FILES)


def _context(place: Path) -> Iterator[Path]:
    yield place
    for folder, folders, files in os.walk(place):
        folders[:] = sorted(f for f in folders if not (f == ".git" and folder == str(place)))
        yield from (Path(folder, name) for name in (*folders, *sorted(files)))


def stats(paths: Iterable[Path]) -> Stats:
    """Of the files that exist."""
    return tuple(found for path in paths if (found := stat_of(str(path))))


def stat_of(path: str) -> tuple[str | int, ...] | None:
    """Name, time, size and inode of a file or folder; None if it does not exist."""
    try:
        facts = os.stat(path)
    except OSError:
        try:
            facts = os.lstat(path)  # a dangling link belongs to the tree too
        except OSError:
            return None
    return path, facts.st_mtime_ns, facts.st_size, facts.st_ino
