"""Files that are either old or new, whenever a process is killed, and private with every umask."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import glob
import os
import re
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

from rorg.regular_file import read_regular

LEFTOVER = re.compile(r"\..+\.([0-9]+)\.[0-9a-f]{8}")
"""The name of a file that is not in its place yet."""
PRIVATE = 0o640
"""The mode of rorg's own files: for its user, and for a group that someone may give the file to."""
MOST = 64 << 20
"""Bytes of a file of the state directory. The largest, of a robot with a thousand services, have some 2 MiB."""


def read_state(path: Path) -> str:
    """The text of a file of the state directory, which anyone may have put there; bytes that are not UTF-8 are
    replaced.

    Raises OSError, whose `strerror` gives the reason: no such file, not a regular file, too large.
    """
    return read_regular(path, MOST).decode("utf-8", errors="replace")


def open_private(path: Path, flags: int) -> int:
    """Open a file that is created if it is missing, and make it private in any case. Raises OSError, also if it is not
    a regular file: opening a pipe would wait for a reader."""
    descriptor = regular(path, flags | os.O_CREAT)
    _set_mode(descriptor, PRIVATE)
    return descriptor


def _set_mode(file: int | Path, mode: int) -> None:
    """Independent of the umask. Files of other users stay as they are, and so do disks without modes."""
    with contextlib.suppress(PermissionError):
        os.chmod(file, mode)


def make_directory(path: Path, mode: int = 0o750) -> None:
    """Make a directory with this mode, and those above it, which all users may enter. An existing one stays unchanged,
    because it belongs to its creator. Raises OSError."""
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
    path: Path,
    text: str,
    durable: bool = True,
    mode: int = PRIVATE,
    owner: tuple[int, int] | None = None,
    placed: Callable[[], None] = lambda: None,
) -> None:
    """Replace a file in one step. `durable` also waits until the disk has it (file and directory). `owner`: a user and
    a group, if this process may give files away; by default the file is ours. `placed` is called when every process
    sees the new content, and a kill cannot take it back; a loss of power still can."""
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
    placed()
    if durable:
        sync(path.parent)


def remove_durably(path: Path) -> None:
    """Remove a file, and wait until the disk knows. Raises OSError."""
    path.unlink()
    sync(path.parent)


def sync(path: Path) -> None:
    """Wait until the disk has the contents of a file, or the names in a directory. Raises OSError."""
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def clear_leftovers(directory: Path, name: str = "") -> None:
    """Remove what a killed write_atomic() left in a directory, of the file with this name or of all. Names of such
    files contain the process; our own number there is of an earlier process."""
    for path in directory.glob(f".{glob.escape(name)}.*" if name else ".*"):
        match = LEFTOVER.fullmatch(path.name)
        if match and (int(match[1]) == os.getpid() or not os.path.exists(f"/proc/{match[1]}")):
            path.unlink(missing_ok=True)


def regular(path: Path, flags: int) -> int:
    """Open a regular file. Raises OSError."""
    descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC, PRIVATE)
    if not stat.S_ISREG(os.fstat(descriptor).st_mode):
        os.close(descriptor)
        raise OSError(errno.EINVAL, "it is not a regular file", str(path))
    return descriptor


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold a lock file during the block; wait for others. The kernel releases it when the holder dies."""
    descriptor = open_private(path, os.O_RDWR)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
