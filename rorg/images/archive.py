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
MOST = 4 << 20
"""Bytes of the records. Those of a robot with a hundred images have some 50 KiB."""


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
    """What an archive says of its images; empty for one that another program wrote. Reads no more than its first
    member, and nothing of that but a regular file. Raises Invalid."""
    try:
        member = tarfile.TarInfo.frombuf(file.read(tarfile.BLOCKSIZE), "utf-8", "surrogateescape")
        if member.name != RECORDS:
            return {}
        if member.type not in (tarfile.REGTYPE, tarfile.AREGTYPE) or not 0 <= member.size <= MOST:
            raise ValueError(f"its {RECORDS} is no file of at most {MOST >> 20} MiB")
        content = file.read(member.size)
        if len(content) < member.size:
            raise ValueError("it ends too early")
        return {str(identity): _built(entry) for identity, entry in json.loads(content).items()}
    except (tarfile.TarError, ValueError, TypeError, AttributeError, RecursionError) as error:
        remedy = "one that `rorg image save` wrote"
        raise Invalid(f"load {name}", f"it is no archive of images: {error}", remedy) from error


def _built(entry: Any) -> Built:
    """A record that an archive brings. Raises TypeError for what is none."""
    found = Built(**entry)
    texts = (found.name, found.reference, found.id, found.at, *found.bases, *found.bases.values())
    if not all(isinstance(text, str) for text in texts):
        raise TypeError(f"a record in its {RECORDS} is not of texts")
    return found
