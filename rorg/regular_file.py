"""Reads a file that anyone may have put there: only regular files, without waiting, and never too much.

It imports only the standard library, because everyday commands read their state with it.
"""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import IO

PIECE = 1 << 20
"""Bytes that are read at a time, so that a high limit does not cost that much memory for a small file."""


def open_regular(path: Path, refuse: Callable[[str], None] = lambda _: None) -> IO[bytes]:
    """Open a regular file. `refuse` gets its real path first, and raises OSError if it may not be read.

    Raises OSError, whose `strerror` says why not."""
    try:
        place = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except ValueError as error:
        raise OSError(errno.EINVAL, "no file can have that name", str(path)) from error
    try:
        # Checked before it is opened: opening a device or a pipe may already do something.
        refuse(os.readlink(f"/proc/self/fd/{place}"))
        mode = os.fstat(place).st_mode
        if not stat.S_ISREG(mode):
            number = errno.EISDIR if stat.S_ISDIR(mode) else errno.EINVAL
            raise OSError(number, "it is not a regular file", str(path))
        descriptor = os.open(f"/proc/self/fd/{place}", os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    finally:
        os.close(place)
    return open(descriptor, "rb")


def read_regular(path: Path, most: int, refuse: Callable[[str], None] = lambda _: None) -> bytes:
    """The content of a regular file of at most `most` bytes. Raises OSError as open_regular(), and if it is larger."""
    pieces, left = list[bytes](), most + 1
    with open_regular(path, refuse) as file:
        # No piece: a file of the kernel that would make us wait.
        while left > 0 and (piece := file.read(min(left, PIECE))):
            pieces.append(piece)
            left -= len(piece)
    if left <= 0:
        raise OSError(errno.EFBIG, f"it has more than {most >> 20} MiB", str(path))
    return b"".join(pieces)
