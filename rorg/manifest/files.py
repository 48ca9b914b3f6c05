"""The one reader of files that others may have written: those of a tree of manifests, of a project to import, and of
the state directory. It reads regular files only, judges each before it opens it, never blocks, and reads no more than a
limit. Each caller says where a file may lie."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import IO

MOST = 4 << 20
"""Bytes of one file. A robot's largest manifests have some 100 KiB."""
EACH, WHOLE, FILES = 1 << 20, 4 << 20, 1000
"""Bytes of one file of a project to import, bytes of all of them, and how many they may be. A file that is read twice
counts twice."""


def read_text(path: Path, root: Path, most: int = MOST) -> str:
    """The text of a file, in UTF-8 with what is not that replaced; otherwise as read_bytes()."""
    return read_bytes(path, root, most).decode("utf-8", errors="replace")


def read_plain(path: Path, root: Path) -> str:
    """The text of a file whose words go to the engine and to programs. Raises OSError as read_bytes(), and for what is
    not UTF-8 or has a NUL character."""
    return _plain(read_bytes(path, root), path)


def read_bytes(path: Path, root: Path, most: int = MOST) -> bytes:
    """The content of a regular file. `root` is the directory of the tree.

    Raises OSError, whose `strerror` says why not: no such file, no regular file, a link that leads out of the tree,
    larger than `most` bytes."""

    def refuse(found: str) -> None:
        if _leads_out(path, found, root):
            raise OSError(errno.EPERM, "it is a link that leads out of the tree", str(path))

    return _read(path, most, refuse)


def read_anywhere(path: Path, most: int) -> bytes:
    """The same, wherever the file lies: a directory that rorg or a person chose has it."""
    return _read(path, most, lambda _: None)


class Outside(PermissionError):
    """A file of a project to import that lies elsewhere: what it says is nobody's business."""


class Reader:
    """Reads a project that a stranger may have written: the files below its folder, and those that a person named, each
    a file or a folder. Links count as what they lead to."""

    def __init__(self, folder: Path, named: Iterable[Path] = ()) -> None:
        self.folder = real(folder)
        self._allowed = (self.folder, *map(real, named))
        self._files = self._bytes = 0

    def __call__(self, path: Path) -> str:
        """The text of a file in UTF-8, its lines ended by "\\n". Raises OSError, whose `strerror` says why not: no such
        file, no regular file, too much, no text. Raises Outside for a file that lies elsewhere."""
        self._files += 1
        if self._files > FILES:
            raise OSError(errno.EMFILE, f"the project names more than {FILES} files", str(path))
        content = _read(path, EACH, lambda found: self._refuse(path, found))
        self._bytes += len(content)
        if self._bytes > WHOLE:
            raise OSError(errno.EFBIG, f"the project's files have more than {WHOLE >> 20} MiB in all", str(path))
        return _plain(content, path).replace("\r\n", "\n").replace("\r", "\n")

    def _refuse(self, path: Path, found: str) -> None:
        if not any(Path(found).is_relative_to(allowed) for allowed in self._allowed):
            raise Outside(errno.EPERM, f"it is outside of the project's folder {self.folder}", str(path))


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


def open_regular(path: Path, refuse: Callable[[str], None] = lambda _: None) -> IO[bytes]:
    """Opens a regular file. `refuse` gets its real path first, and raises OSError for what may not be read.
    Raises OSError."""
    try:
        place = os.open(path, os.O_PATH | os.O_CLOEXEC)
    except ValueError as error:
        raise OSError(errno.EINVAL, "no file can have that name", str(path)) from error
    try:
        # Judged before it is opened: to open a device, or a pipe, may already do something.
        refuse(os.readlink(f"/proc/self/fd/{place}"))
        mode = os.fstat(place).st_mode
        if not stat.S_ISREG(mode):
            number = errno.EISDIR if stat.S_ISDIR(mode) else errno.EINVAL
            raise OSError(number, "it is not a regular file", str(path))
        descriptor = os.open(f"/proc/self/fd/{place}", os.O_RDONLY | os.O_NONBLOCK | os.O_NOCTTY | os.O_CLOEXEC)
    finally:
        os.close(place)
    return open(descriptor, "rb")


def _read(path: Path, most: int, refuse: Callable[[str], None]) -> bytes:
    with open_regular(path, refuse) as file:
        content = file.read(most + 1) or b""  # nothing: a file of the kernel's that would make us wait
    if len(content) > most:
        raise OSError(errno.EFBIG, f"it has more than {most >> 20} MiB", str(path))
    return content


def _plain(content: bytes, path: Path) -> str:
    try:
        text = content.decode()
    except UnicodeDecodeError as error:
        raise OSError(errno.EILSEQ, f"it is not UTF-8 at byte {error.start}", str(path)) from error
    if "\0" in text:
        raise OSError(errno.EILSEQ, "it has a NUL character", str(path))
    return text
