"""The context of a build: which files it has, and how they get to an engine on any machine."""

from __future__ import annotations

import io
import os
import shutil
import stat
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from rorg.images.ignore import NAME, Ignore, read_ignore
from rorg.manifest.files import read_bytes

GIT = ".git"
"""Left out at the top of a context: otherwise every commit would change the image."""
OWN = ".rorg.Dockerfile"
"""The name of the Dockerfile in a tar."""


def context_files(context: Path, dockerfile: str, ignored: Path | None = None) -> Iterator[tuple[str, os.stat_result]]:
    """Everything that a build can see: paths in the context with their status (links are not followed).

    Regular files, links and directories in alphabetical order, each directory before its content. Left out are `.git`
    at the top, everything in `.dockerignore`, and sockets, pipes and devices. `ignored`: the directory with the
    `.dockerignore`, if it is not the context. Raises OSError if a directory, or the `.dockerignore`, is unreadable."""
    ignore = read_ignore(ignored or context, dockerfile)
    yield from _below(context, (), ignore)


def _below(directory: Path, above: tuple[str, ...], ignore: Ignore) -> Iterator[tuple[str, os.stat_result]]:
    with os.scandir(directory) as scan:
        entries = sorted(scan, key=lambda entry: entry.name)
    for entry in entries:
        parts, how = (*above, entry.name), entry.stat(follow_symlinks=False)
        if parts == (GIT,) or stat.S_IFMT(how.st_mode) not in (stat.S_IFREG, stat.S_IFLNK, stat.S_IFDIR):
            continue
        if not ignore.leaves_out(parts):
            yield "/".join(parts), how
        elif not stat.S_ISDIR(how.st_mode) or ignore.leaves_out_all_of(parts):
            continue
        if stat.S_ISDIR(how.st_mode):
            yield from _below(directory / entry.name, parts, ignore)


def write_tar(context: Path, dockerfile: str, text: bytes, file: IO[bytes]) -> str:
    """Writes a context with this text as its Dockerfile, and returns the Dockerfile's name there. Files belong to root,
    as with the docker command, and times are whole seconds. Raises OSError.

    No file of the context has the Dockerfile's name. The `.dockerignore` in the tar lists it, so that the build does
    not see it. The docker command does the same with a Dockerfile from elsewhere."""
    name = OWN
    while os.path.lexists(context / name):
        name += "_"
    hidden = f"{NAME}\n"
    with tarfile.open(fileobj=file, mode="w", format=tarfile.PAX_FORMAT) as tar:
        for path, how in context_files(context, dockerfile):
            if path == NAME and stat.S_ISREG(how.st_mode):
                ignored = read_bytes(context / NAME, context).decode(errors="surrogateescape")
                hidden = ignored.rstrip("\n") + "\n"
                continue
            _add(tar, context / path, path, how)
        for added, content in ((name, text), (NAME, f"{hidden}{name}\n".encode(errors="surrogateescape"))):
            member = tarfile.TarInfo(added)
            member.size, member.mode = len(content), 0o600
            tar.addfile(member, io.BytesIO(content))
    return name


def _add(tar: tarfile.TarFile, place: Path, path: str, how: os.stat_result) -> None:
    member = tarfile.TarInfo(path)
    member.mode, member.mtime = stat.S_IMODE(how.st_mode), int(how.st_mtime)
    if stat.S_ISDIR(how.st_mode):
        member.type = tarfile.DIRTYPE
        tar.addfile(member)
    elif stat.S_ISLNK(how.st_mode):
        member.type, member.linkname = tarfile.SYMTYPE, os.readlink(place)
        tar.addfile(member)
    else:
        with open(place, "rb") as content:
            member.size = os.fstat(content.fileno()).st_size
            tar.addfile(member, content)


def copy_context(context: Path, dockerfile: str, target: Path) -> None:
    """Copies a context into a new directory, with links, modes and times. Raises OSError."""
    target.mkdir()
    directories: list[tuple[Path, Path]] = []
    for path, how in context_files(context, dockerfile):
        source, place = context / path, target / path
        if stat.S_ISDIR(how.st_mode):
            place.mkdir(parents=True, exist_ok=True)
            directories.append((source, place))
        else:
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, place, follow_symlinks=False)
    for source, place in reversed(directories):  # last, because some may not be writable afterwards
        shutil.copystat(source, place)
