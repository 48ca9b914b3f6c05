"""Files that are either as before or as meant, whatever is killed when; and as private as meant, whatever the umask."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import re
import stat
from collections.abc import Iterator
from pathlib import Path

from rorg.regular_file import read_regular

LEFTOVER = re.compile(r"\..+\.([0-9]+)\.[0-9a-f]{8}")
"""The name of a file on its way to its place."""
PRIVATE = 0o640
"""The mode of what rorg keeps for itself: for its user, and for a group that somebody gives the file to."""
MOST = 64 << 20
"""Bytes of a file of the state directory. The largest, of a robot with a thousand services, have some 2 MiB."""


def read_state(path: Path) -> str:
    """The text of a file of the state directory, whoever has put what into its place; what is not UTF-8 is replaced.

    Raises OSError, whose `strerror` says why not: no such file, no regular file, too large."""
    return read_regular(path, MOST).decode("utf-8", errors="replace")


def open_private(path: Path, flags: int) -> int:
    """A descriptor of a file that is made where it is not there, private by whomever it was made. Raises OSError, also
    for what is no regular file: to open a pipe would wait for a reader."""
    descriptor = regular(path, flags | os.O_CREAT)
    _set_mode(descriptor, PRIVATE)
    return descriptor


def _set_mode(file: int | Path, mode: int) -> None:
    """Whatever the umask made of it. Another user's files stay as they are, and so does a disk that knows no modes."""
    with contextlib.suppress(PermissionError):
        os.chmod(file, mode)


def make_directory(path: Path, mode: int = 0o750) -> None:
    """Makes a directory of this mode, and those above it, which everybody may enter. One that is there stays as it is:
    it is of whoever made it. Raises OSError."""
    if path.is_dir():
        return
    make_directory(path.parent, 0o755)
    try:
        path.mkdir(mode=0o700)
    except FileExistsError:
        if not path.is_dir():
            raise
    else:
        _set_mode(path, mode)


def write_atomic(
    path: Path, text: str, durable: bool = True, mode: int = PRIVATE, owner: tuple[int, int] | None = None
) -> None:
    """Replaces a file in one step. `durable` also waits until the disk has it (file and directory). `owner`: a user
    and a group, for whoever may give files away; without, the file is ours."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.{os.urandom(4).hex()}")
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as file:
            if owner is not None:
                with contextlib.suppress(PermissionError):
                    os.fchown(descriptor, *owner)
            _set_mode(descriptor, mode)
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


def clear_leftovers(directory: Path) -> None:
    """Removes what a killed write_atomic() left in a directory. The process of such a file is in its name; what is of
    our own number is from before we began."""
    for path in directory.glob(".*"):
        found = LEFTOVER.fullmatch(path.name)
        if found and (int(found[1]) == os.getpid() or not os.path.exists(f"/proc/{found[1]}")):
            path.unlink(missing_ok=True)


def regular(path: Path, flags: int) -> int:
    """A descriptor of a regular file. Raises OSError."""
    descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC, PRIVATE)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))
    return descriptor


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Holds a lock file while the block runs; waits for others. The kernel gives it back when the holder dies."""
    descriptor = open_private(path, os.O_RDWR)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
