"""The identity of an image: a digest of everything that it is built from, and nothing else. It is therefore the same on
every machine and after every `git revert`, and a rollback finds the image that ran before."""

from __future__ import annotations

import hashlib
import json
import os
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from rorg.errors import Invalid
from rorg.host.contents import FileDigests
from rorg.images.context import context_files
from rorg.model.catalog import Catalog, Image
from rorg.model.graph import parents_first
from rorg.model.image_names import plain

VERSION = "v1"
MOST_FILES, MOST_BYTES = 100_000, 2 << 30
"""Limits of one context."""


class Identities:
    """Computes identities. Remembers digests of files with their status, so that only changed files are read again."""

    def __init__(self) -> None:
        self.files = FileDigests()

    def of(self, catalog: Catalog) -> dict[str, str]:
        """Image -> 64 hexadecimal digits.

        They depend on the files of its context (names, modes, links, content; not times), the Dockerfile, arguments,
        target and platform, the identities of its bases in the tree, and the references of its other bases. For an
        imported image, they depend on the command and the files that it names. Raises Invalid."""
        self.files.begin()
        identities: dict[str, str] = {}
        for name in parents_first(catalog.images):
            identities[name] = self.one(catalog.images[name], identities)
        return identities

    def one(self, image: Image, identities: Mapping[str, str]) -> str:
        """The identity of one image, given those of its bases in the tree. Raises Invalid."""
        below = [identities.get(plain(base), base) for base in image.bases]
        return _digest([VERSION, *_said(image), below, self._files(image)])

    def _files(self, image: Image) -> list[Any]:
        if image.context is None:
            return [self._one(os.path.join(image.directory, word)) for word in image.import_command or ()]
        context = Path(image.context)
        files = [self._entry(context, name, facts) for name, facts in _bounded(image, context)]
        return [image.inline or self._one(str(context / image.dockerfile)), *files]

    def _entry(self, context: Path, name: str, facts: os.stat_result) -> tuple[str, int, str]:
        told = "" if stat.S_ISDIR(facts.st_mode) else self.files.of(str(context / name), facts)
        return name, facts.st_mode, told

    def _one(self, path: str) -> str:
        """The digest of a single file; "" if it does not exist."""
        try:
            facts = os.stat(path)
        except (OSError, ValueError):
            return ""
        return self.files.of(os.path.realpath(path), facts) if stat.S_ISREG(facts.st_mode) else ""


def _bounded(image: Image, context: Path) -> Iterator[tuple[str, os.stat_result]]:
    """The files of a context. Raises Invalid if they cannot be read, or if there are too many: all of them would be
    read while the robot waits."""
    count, size = 0, 0
    try:
        for name, facts in context_files(context, image.dockerfile):
            count, size = count + 1, size + facts.st_size * stat.S_ISREG(facts.st_mode)
            if count > MOST_FILES or size > MOST_BYTES:
                much = f"{context} has more than {MOST_FILES:,} files or {MOST_BYTES >> 30} GiB"
                raise Invalid(f"build {image.name}", much, "a .dockerignore for files that the build does not need")
            yield name, facts
    except OSError as error:
        why = f"{error.filename or context}: {error.strerror}"
        raise Invalid(f"build {image.name}", why, "to make it readable, or exclude it in .dockerignore") from error


def _said(image: Image) -> list[Any]:
    said = [image.name, image.dockerfile, dict(image.args), image.target, image.platform, image.import_command]
    return [*said, dict(image.stand_ins)] if image.stand_ins else said


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode(errors="surrogateescape")).hexdigest()


def rebuilt_identity(identity: str, bases: Mapping[str, str]) -> str:
    """The identity of an image that is rebuilt from the same files on other bases."""
    return _digest([VERSION, identity, dict(bases)])
