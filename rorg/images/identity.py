"""The identity of an image: a digest of all that it is made from, and of nothing else. So it is the same on every
machine and after every `git revert`, and a rollback finds the image that ran before."""

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
"""Of one context."""


class Identities:
    """Remembers digests of files by what stat says of them, so that only what changed is read again."""

    def __init__(self) -> None:
        self.files = FileDigests()

    def of(self, catalog: Catalog) -> dict[str, str]:
        """Image -> 64 hexadecimal digits. What counts: the files of its context (names, modes, links, content; not
        times), the Dockerfile, arguments, target and platform; identities of the images of the tree that it stands on,
        and the references of others. Of an imported one: the command, and the files that it names. Raises
        Invalid."""
        self.files.begin()
        found: dict[str, str] = {}
        for name in parents_first(catalog.images):
            found[name] = self.one(catalog.images[name], found)
        return found

    def one(self, image: Image, identities: Mapping[str, str]) -> str:
        """Of an image, with those of the images of the tree that it stands on. Raises Invalid."""
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
        """A file that is named by itself; "" where there is none."""
        try:
            facts = os.stat(path)
        except (OSError, ValueError):
            return ""
        return self.files.of(os.path.realpath(path), facts) if stat.S_ISREG(facts.st_mode) else ""


def _bounded(image: Image, context: Path) -> Iterator[tuple[str, os.stat_result]]:
    """The files of a context. Raises Invalid for what cannot be read, and where there is more than anybody means to
    build from: it would be read whole, while the robot waits."""
    count, size = 0, 0
    try:
        for name, facts in context_files(context, image.dockerfile):
            count, size = count + 1, size + facts.st_size * stat.S_ISREG(facts.st_mode)
            if count > MOST_FILES or size > MOST_BYTES:
                much = f"{context} has more than {MOST_FILES:,} files or {MOST_BYTES >> 30} GiB"
                raise Invalid(f"build {image.name}", much, "a .dockerignore for what it is not built from")
            yield name, facts
    except OSError as error:
        why = f"{error.filename or context}: {error.strerror}"
        raise Invalid(f"build {image.name}", why, "making it readable, or a line for it in .dockerignore") from error


def _said(image: Image) -> list[Any]:
    said = [image.name, image.dockerfile, dict(image.args), image.target, image.platform, image.import_command]
    return [*said, dict(image.stand_ins)] if image.stand_ins else said


def _digest(value: Any) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True).encode(errors="surrogateescape")).hexdigest()


def renewed(identity: str, bases: Mapping[str, str]) -> str:
    """Of an image that is built again from the same files on other bases."""
    return _digest([VERSION, identity, dict(bases)])
