"""A robot's images in one file, to copy them to another machine without a registry. It is the tar file that
`docker save` writes, plus one member that `docker load` ignores."""

from __future__ import annotations

import json
import tarfile
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import IO

from rorg.errors import Invalid
from rorg.images.records import Built

RECORDS = "rorg-images.json"
MOST = 4 << 20
"""Bytes of the records. Those of a robot with a hundred images take about 50 KiB."""


def write_archive(pieces: Iterable[bytes], built: Mapping[str, Built], file: IO[bytes]) -> None:
    """Writes the records of what the images were built from, and behind them the tar file that an engine saves."""
    records = json.dumps({identity: asdict(b) for identity, b in sorted(built.items())}).encode()
    member = tarfile.TarInfo(RECORDS)
    member.size = len(records)
    file.write(member.tobuf(tarfile.PAX_FORMAT) + records + bytes(-len(records) % tarfile.BLOCKSIZE))
    file.writelines(pieces)


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
        return {str(identity): Built.read(entry) for identity, entry in json.loads(content).items()}
    except (tarfile.TarError, ValueError, TypeError, AttributeError, RecursionError) as error:
        remedy = "one that `rorg image save` wrote"
        raise Invalid(f"load {name}", f"it is not an archive of images: {error}", remedy) from error
