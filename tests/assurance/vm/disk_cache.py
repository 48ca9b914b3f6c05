"""A disk with a write cache that loses its content in a power cut. qemu's driver blklogwrites notes what the guest does
with its disk; `replay` makes the disk that a cut may leave: with all that was flushed, and some of what was not."""

from __future__ import annotations

import random
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

MAGIC = 0x6A736677736872
FLUSH, FUA, DISCARD = 1, 2, 4
HEAD, ENTRY = struct.Struct("<QQQI"), struct.Struct("<QQQQ")


@dataclass(frozen=True)
class Entry:
    """A request of the guest. A discard has a size, and no data in the log."""

    start: int
    size: int
    flags: int
    data: int
    """Where its data is in the log. All figures are in bytes."""


def entries(log: BinaryIO) -> Iterator[Entry]:
    """Until the end of the log: a qemu that was killed has not counted them."""
    magic, _, _, sector = HEAD.unpack(log.read(HEAD.size))
    assert magic == MAGIC, f"{magic:x}"
    place = sector
    while True:
        log.seek(place)
        head = log.read(ENTRY.size)
        start, count, flags, _ = ENTRY.unpack(head) if len(head) == ENTRY.size else (0, 0, 0, 0)
        if not (count or flags):
            return
        entry = Entry(start * sector, count * sector, flags, place + sector)
        yield entry
        place += sector + (0 if flags & DISCARD else entry.size)


def replay(log: Path, disk: Path, dice: random.Random, kept: float) -> tuple[int, int]:
    """Writes into `disk`, which is as it was at the boot, all until the last flush, and each later write with the
    probability `kept`. Returns how many later writes there were, and how many of them were lost."""
    later = lost = 0
    with log.open("rb") as source, disk.open("r+b") as target:
        found = list(entries(source))
        last = max((number for number, entry in enumerate(found) if entry.flags & FLUSH), default=-1)
        for number, entry in enumerate(found):
            if entry.flags & DISCARD or not entry.size:
                continue
            if number > last and not entry.flags & FUA:
                later += 1
                if dice.random() >= kept:
                    lost += 1
                    continue
            source.seek(entry.data)
            target.seek(entry.start)
            target.write(source.read(entry.size))
    return later, lost
