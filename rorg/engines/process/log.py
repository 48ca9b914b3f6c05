"""What the programs of the process engine print: one file each, read while it grows."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path


def read_log(path: Path, follow: bool, tail: int | None) -> Iterator[bytes]:
    """The last `tail` lines, then, when following, what comes, until the container is removed."""
    with path.open("rb") if path.exists() else open(os.devnull, "rb") as file:
        lines = file.readlines()
        yield from lines if tail is None else lines[max(0, len(lines) - tail) :]
        while follow and path.parent.exists():
            line = file.readline()
            if line:
                yield line
            else:
                time.sleep(0.1)


def read_log_from(path: Path, offset: int) -> bytes:
    """Everything from an offset on."""
    if not path.exists():
        return b""
    with path.open("rb") as file:
        file.seek(offset)
        return file.read()
