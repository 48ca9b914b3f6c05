"""A robot's images in one file: to another machine, without a registry. It is the tar file that `docker save` writes,
with one more member, which `docker load` does not look at."""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import IO, Any

from rorg.errors import Invalid
from rorg.images.records import Built

RECORDS = "rorg-images.json"
CHUNK = 1 << 20


class Stream(io.RawIOBase):
    """Pieces of an answer, to be read as a file."""

    def __init__(self, pieces: Iterable[bytes]) -> None:
        self._pieces, self._left = iter(pieces), b""

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        while not self._left:
            piece = next(self._pieces, None)
            if piece is None:
                return 0
            self._left = piece
        size = min(len(buffer), len(self._left))
        buffer[:size], self._left = self._left[:size], self._left[size:]
        return size


def write_archive(pieces: Iterable[bytes], built: Mapping[str, Built], file: IO[bytes]) -> None:
    """What an engine saves, with which of it was built from what."""
    records = json.dumps({identity: asdict(b) for identity, b in sorted(built.items())}).encode()
    source = io.BufferedReader(Stream(pieces), CHUNK)
    with tarfile.open(fileobj=file, mode="w", format=tarfile.PAX_FORMAT) as to:
        member = tarfile.TarInfo(RECORDS)
        member.size = len(records)
        to.addfile(member, io.BytesIO(records))
        with tarfile.open(fileobj=source, mode="r|") as saved:
            for entry in saved:
                to.addfile(entry, saved.extractfile(entry) if entry.isreg() else None)


def read_records(file: IO[bytes], name: str) -> dict[str, Built]:
    """What an archive says of its images; empty for one that another program wrote. Raises Invalid."""
    try:
        with tarfile.open(fileobj=file, mode="r:") as archive:
            first = archive.next()
            content = archive.extractfile(first) if first is not None and first.name == RECORDS else None
            entries = json.load(content) if content else {}
            return {str(identity): Built(**entry) for identity, entry in entries.items()}
    except (tarfile.TarError, ValueError, TypeError, AttributeError, EOFError) as error:
        raise Invalid(
            f"load {name}", f"it is no archive of images: {error}", "one that `rorg image save` wrote"
        ) from error
