"""Where files of a tree of manifests, and of a project to import, may lie, and how large they may be. How they are read
is in rorg/regular_file.py."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable
from pathlib import Path

from rorg.regular_file import read_regular

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

    return read_regular(path, most, refuse)


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
        content = read_regular(path, EACH, lambda found: self._refuse(path, found))
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


def _plain(content: bytes, path: Path) -> str:
    try:
        text = content.decode()
    except UnicodeDecodeError as error:
        raise OSError(errno.EILSEQ, f"it is not UTF-8 at byte {error.start}", str(path)) from error
    if "\0" in text:
        raise OSError(errno.EILSEQ, "it has a NUL character", str(path))
    return text
