"""Digests of files by what stat says of them, so that only what changed is read again."""

from __future__ import annotations

import hashlib
import os
import stat

Facts = tuple[int, int, int, int]
Known = dict[str, tuple[Facts, str]]


class FileDigests:
    """Between two calls of begin() every file is asked for that matters; the others are forgotten."""

    def __init__(self) -> None:
        self._known: Known = {}
        self._before: Known = {}
        self.read = 0
        """Files read so far."""

    def begin(self) -> None:
        self._before, self._known = self._known, {}

    def of(self, path: str, facts: os.stat_result) -> str:
        """The target of a link; of a regular file 64 hexadecimal digits; of what cannot be read, why."""
        try:
            return os.readlink(path) if stat.S_ISLNK(facts.st_mode) else self._file(path, facts)
        except OSError as error:
            return f"unreadable: {error.errno}"

    def _file(self, path: str, facts: os.stat_result) -> str:
        key = (facts.st_mtime_ns, facts.st_ctime_ns, facts.st_size, facts.st_ino)
        found = self._known.get(path) or self._before.get(path)
        if found is None or found[0] != key:
            self.read += 1
            descriptor = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC)
            with open(descriptor, "rb") as file:
                found = key, hashlib.file_digest(file, "sha256").hexdigest()
        self._known[path] = found
        return found[1]
