"""Files that are either as before or as meant, whatever is killed when."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import stat
from collections.abc import Iterator
from pathlib import Path

MOST = 64 << 20
"""Bytes of a file of the state directory. The largest, of a robot with a thousand services, have some 2 MiB."""


def read_state(path: Path) -> str:
    """The text of a file of the state directory, whoever has put what into its place; what is not UTF-8 is replaced.

    Raises OSError, whose `strerror` says why not: no such file, no regular file, too large."""
    with open(_regular(path, os.O_RDONLY), "rb") as file:
        content = file.read(MOST + 1)
    if len(content) > MOST:
        raise OSError(errno.EFBIG, f"it has more than {MOST >> 20} MiB", str(path))
    return content.decode("utf-8", errors="replace")


def write_atomic(path: Path, text: str, durable: bool = True, mode: int = 0o640) -> None:
    """Replaces a file in one step. `durable` also waits until the disk has it (file and directory)."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.{os.urandom(4).hex()}")
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            if durable:
                os.fsync(file.fileno())
        os.replace(temporary, path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
    if durable:
        directory = os.open(path.parent, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)


def appendable(path: Path) -> int:
    """A descriptor to write at the end of a file, which is made where there is none. Raises OSError for what is no
    regular file: to open a pipe would wait for a reader."""
    return _regular(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT)


def _regular(path: Path, flags: int) -> int:
    descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC, 0o666)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "it is no regular file", str(path))
    return descriptor


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Holds a lock file while the block runs; waits for others. The kernel gives it back when the holder dies."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o640)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
