"""A robot's images in one file, to copy them to another machine without a registry. It is the tar file that
`docker save` writes, plus one member that `docker load` ignores."""

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
MOST = 4 << 20
"""Bytes of the records. Those of a robot with a hundred images take about 50 KiB."""


class Stream(io.RawIOBase):
    """Makes the pieces of an answer readable as a file."""

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
    """Writes the images that an engine saves, and the records of what they were built from."""
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
    """The records in an archive; empty if another program wrote it. Reads no more than its first member, and only if
    that is a regular file. Raises Invalid."""
    try:
        member = tarfile.TarInfo.frombuf(file.read(tarfile.BLOCKSIZE), "utf-8", "surrogateescape")
        if member.name != RECORDS:
            return {}
        if member.type not in (tarfile.REGTYPE, tarfile.AREGTYPE) or not 0 <= member.size <= MOST:
            raise ValueError(f"its {RECORDS} is not a file of at most {MOST >> 20} MiB")
        content = file.read(member.size)
        if len(content) < member.size:
            raise ValueError("it ends too early")
        return {str(identity): _built(entry) for identity, entry in json.loads(content).items()}
    except (tarfile.TarError, ValueError, TypeError, AttributeError, RecursionError) as error:
        remedy = "one that `rorg image save` wrote"
        raise Invalid(f"load {name}", f"it is not an archive of images: {error}", remedy) from error


def _built(entry: Any) -> Built:
    """A record from an archive. Raises TypeError if it is not valid."""
    found = Built(**entry)
    texts = (found.name, found.reference, found.id, found.at, *found.bases, *found.bases.values())
    if not all(isinstance(text, str) for text in texts):
        raise TypeError(f"a record in its {RECORDS} does not consist of texts")
    return found
