"""Copies files and directories as cp -r does: where a copy goes on every engine, and copies on this machine."""

from __future__ import annotations

import contextlib
import os
import shutil
import tarfile
from collections.abc import Iterator
from pathlib import Path

from rorg.engines.unpack import LeadsOut
from rorg.errors import Invalid


def place_of(source: str, place: Path, is_directory: bool, of_directory: bool) -> Path:
    """The name of the copy. If `place` is a directory, the copy goes into it under its own name; the content of a
    directory (`DIR/.`, with `of_directory`) goes directly into it."""
    content = of_directory and os.path.basename(source) in ("", ".", "..")
    return place if content or not is_directory else place / os.path.basename(source.rstrip("/"))


@contextlib.contextmanager
def refused(what: str) -> Iterator[None]:
    """Turn errors of the disk or of an archive into Invalid."""
    try:
        yield
    except LeadsOut as error:
        raise Invalid(what, str(error), "`rorg exec SERVICE -- tar c PATH | tar x`, if you trust it") from error
    except (FileNotFoundError, FileExistsError, NotADirectoryError, IsADirectoryError, PermissionError) as error:
        raise Invalid(what, f"{error.filename}: {error.strerror}", "another place") from error
    except tarfile.TarError as error:
        raise Invalid(what, f"what the engine sent is not an archive: {error}") from error


def copy(source: str, place: str) -> None:
    """Copy like cp -r: modes and links are kept. Raises Invalid."""
    origin, directory = Path(source), Path(source).is_dir()
    target = place_of(source, Path(place), Path(place).is_dir(), directory)
    what = f"copy {source} to {target}"
    if not directory and not origin.is_file():
        why = "it is neither a file nor a directory" if origin.exists() else "no such file"
        raise Invalid(what, why, "another path")
    if target.resolve() == origin.resolve() or (directory and origin.resolve() in target.resolve().parents):
        raise Invalid(what, "it would be copied into itself", "another place")
    try:
        with refused(what):
            if directory:
                shutil.copytree(source, target, symlinks=True, dirs_exist_ok=True)
            else:
                shutil.copy2(source, target)
    except shutil.Error as error:
        raise Invalid(what, str(error.args[0][0][2]), "another place") from error
