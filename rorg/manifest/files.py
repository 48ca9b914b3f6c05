"""Reading files that a tree of manifests is made of. Whoever may commit to a tree may not make rorg read anything else:
only regular files are read, never for long, never much, and no link leads out of the tree."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

MOST = 4 << 20
"""Bytes of one file. A robot's largest manifests have some 100 KiB."""


def read_text(path: Path, root: Path, most: int = MOST) -> str:
    """The text of a file, in UTF-8 with what is not that replaced; otherwise as read_bytes()."""
    return read_bytes(path, root, most).decode("utf-8", errors="replace")


def read_plain(path: Path, root: Path) -> str:
    """The text of a file whose words go to the engine and to programs. Raises OSError as read_bytes(), and for what is
    not UTF-8 or has a NUL character."""
    content = read_bytes(path, root)
    try:
        text = content.decode()
    except UnicodeDecodeError as error:
        raise OSError(errno.EILSEQ, f"it is not UTF-8 at byte {error.start}", str(path)) from error
    if "\0" in text:
        raise OSError(errno.EILSEQ, "it has a NUL character", str(path))
    return text


def read_bytes(path: Path, root: Path, most: int = MOST) -> bytes:
    """The content of a regular file. `root` is the directory of the tree.

    Raises OSError, whose `strerror` says why not: no such file, no regular file, a link that leads out of the tree,
    larger than `most` bytes."""
    try:
        place = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except ValueError as error:
        raise OSError(errno.EINVAL, "no file can have that name", str(path)) from error
    try:
        # Judged before it is opened: to open a device, or a pipe, may already do something.
        if not stat.S_ISREG(os.fstat(place).st_mode):
            raise OSError(errno.EINVAL, "it is not a regular file", str(path))
        if _leads_out(path, os.readlink(f"/proc/self/fd/{place}"), root):
            raise OSError(errno.EPERM, "it is a link that leads out of the tree", str(path))
        descriptor = os.open(f"/proc/self/fd/{place}", os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    finally:
        os.close(place)
    with open(descriptor, "rb") as file:
        content = file.read(most + 1)
    if len(content) > most:
        raise OSError(errno.EFBIG, f"it has more than {most >> 20} MiB", str(path))
    return content


def real(path: Path | str) -> Path:
    """The absolute path without links, as far as it is there. Links in a ring, and names that no file can have,
    stay as they are written."""
    return Path(os.path.realpath(path))


def _leads_out(path: Path, real: str, root: Path) -> bool:
    """Whether links on the way from the tree to a file lead out of it. A path that says so itself (../shared, /etc) is
    somebody's declared wish, and no link."""
    top = os.path.realpath(root)
    if real == top or real.startswith(f"{top}/"):
        return False
    written = os.path.abspath(path)
    base = os.path.abspath(root)
    return written == base or written.startswith(f"{base}/")
