"""Limits on the files of a tree and of a project to import: where they may be, and how large. rorg/regular_file.py does
the reading."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable
from pathlib import Path

from rorg.regular_file import read_regular

MOST = 4 << 20
"""Bytes of one file. A robot's largest manifests have some 100 KiB."""
EACH, WHOLE, FILES = 1 << 20, 4 << 20, 1000
"""Limits of a project to import: bytes of one file, bytes of all files, number of files. A file that is read twice
counts twice."""


def read_text(path: Path, root: Path, most: int = MOST) -> str:
    """Returns the text of a file, with invalid UTF-8 replaced; otherwise like read_bytes()."""
    return read_bytes(path, root, most).decode("utf-8", errors="replace")


def read_plain(path: Path, root: Path) -> str:
    """Returns text that goes to the engine or to programs. Raises OSError like read_bytes(), and also for invalid UTF-8
    and for NUL characters."""
    return _plain(read_bytes(path, root), path)


def read_bytes(path: Path, root: Path, most: int = MOST) -> bytes:
    """Returns the content of a regular file. `root` is the directory of the tree.

    Raises OSError with the reason in `strerror`: no such file, not a regular file, a link that leads out of the tree,
    or larger than `most` bytes.
    """

    def refuse(target: str) -> None:
        if _leads_out(path, target, root):
            raise OSError(errno.EPERM, "it is a link that leads out of the tree", str(path))

    return read_regular(path, most, refuse)


class Outside(PermissionError):
    """A file outside the project to import, which rorg must not read."""


class Reader:
    """Reads files of an untrusted project: those below its folder, and files or folders that a person named. Links
    count as their targets."""

    def __init__(self, folder: Path, named: Iterable[Path] = ()) -> None:
        self.folder = real(folder)
        self._allowed = (self.folder, *map(real, named))
        self._files = self._bytes = 0

    def __call__(self, path: Path) -> str:
        """Returns the text of a UTF-8 file, with lines that end in "\
        ". Raises OSError with the reason in `strerror`: no such file, not a regular file, too much, not text. Raises
        Outside for a file elsewhere.
        """
        self._files += 1
        if self._files > FILES:
            raise OSError(errno.EMFILE, f"the project names more than {FILES} files", str(path))
        content = read_regular(path, EACH, lambda found: self._refuse(path, found))
        self._bytes += len(content)
        if self._bytes > WHOLE:
            raise OSError(errno.EFBIG, f"the project's files have more than {WHOLE >> 20} MiB in all", str(path))
        return _plain(content, path).replace("\r\n", "\n").replace("\r", "\n")

    def _refuse(self, path: Path, target: str) -> None:
        if not any(Path(target).is_relative_to(allowed) for allowed in self._allowed):
            raise Outside(errno.EPERM, f"it is outside of the project's folder {self.folder}", str(path))


def real(path: Path | str) -> Path:
    """The absolute path with links resolved. Link cycles and impossible names stay as they are written."""
    return Path(os.path.realpath(path))


def _leads_out(path: Path, real: str, root: Path) -> bool:
    """Whether links between the tree and a file lead out of the tree. A path that is written to lead out (../shared,
    /etc) is intended, and is not such a link."""
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
