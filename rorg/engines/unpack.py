"""Unpacks tar archives that are not trusted. The filters of the standard library do that too, but Python 3.11 has them
only since 3.11.4, and Debian bookworm's is older."""

from __future__ import annotations

import os
import posixpath
import stat
import tarfile
from collections.abc import Iterable, Iterator
from copy import copy
from pathlib import Path

NEVER = stat.S_ISUID | stat.S_ISGID | stat.S_ISVTX
"""Bits of a mode that are dropped, because the owner changes."""


class LeadsOut(tarfile.TarError):
    """An entry that would be written, or that points, outside of the folder; or one that is neither a file, a directory
    nor a link."""

    def __init__(self, member: tarfile.TarInfo) -> None:
        super().__init__(f"'{member.name}' leads out of it")


def unpack(archive: tarfile.TarFile, folder: Path, members: Iterable[tarfile.TarInfo], links: bool = False) -> None:
    """Unpack `members`, which come one after another from the archive. With `links`, symbolic links may point anywhere.
    Nothing is written through one. Raises LeadsOut and other kinds of TarError, and OSError."""
    archive.extraction_filter = lambda member, _: member  # else newer ones apply, or warn of, their own
    archive.extractall(folder, members=_checked(folder, members, links))


def _checked(folder: Path, members: Iterable[tarfile.TarInfo], links: bool) -> Iterator[tarfile.TarInfo]:
    """Each entry is looked at when those before it have been unpacked."""
    for member in map(copy, members):
        if not (member.isreg() or member.isdir() or member.issym() or member.islnk()):
            raise LeadsOut(member)
        if not _is_inside(member.name) or _through_link(folder, member.name, whole=not member.issym()):
            raise LeadsOut(member)
        if member.islnk() and (not _is_inside(member.linkname) or _through_link(folder, member.linkname)):
            raise LeadsOut(member)
        if member.issym() and not links:
            # In this form, `..` comes first: none of them leaves a directory that a link before it led to.
            member.linkname = posixpath.normpath(member.linkname)
            if not _is_inside(posixpath.join(posixpath.dirname(member.name), member.linkname)):
                raise LeadsOut(member)
        member.mode = stat.S_IMODE(member.mode) & ~NEVER
        member.uid, member.gid, member.uname, member.gname = os.geteuid(), os.getegid(), "", ""
        yield member


def _is_inside(path: str) -> bool:
    return not path.startswith("/") and posixpath.normpath(path).partition("/")[0] != ".."


def _through_link(folder: Path, path: str, whole: bool = True) -> bool:
    """Whether a directory on the way is a symbolic link; with `whole`, or the entry itself."""
    parts = [part for part in path.split("/") if part not in ("", ".")]
    return any(folder.joinpath(*parts[: n + 1]).is_symlink() for n in range(len(parts) if whole else len(parts) - 1))
