"""Writing what an import made. A new directory appears at once and whole; into one that is there, files go whole, one
right after the other, once all of them are on the disk."""

from __future__ import annotations

import errno
import os
import re
import shutil
from collections.abc import Iterable
from pathlib import Path

from rorg.importing.manifests import Imported
from rorg.manifest.files import real
from rorg.manifest.schema import write as write_schemas

_PART = re.compile(r"\..*\.part([0-9]+)")
"""The name of a directory on its way. A killed import leaves it; the next one removes it."""


def there_already(imported: Imported, output: Path) -> list[Path]:
    """Files that would be written over."""
    return [output / name for name in imported.texts if os.path.lexists(output / name)]


def write_tree(imported: Imported, output: Path) -> None:
    """Writes all files of an import, and the schemas of manifests. Raises OSError, and then has changed nothing but
    what it wrote last."""
    for name in imported.texts:
        if not real((output / name).parent).is_relative_to(real(output)):
            raise OSError(errno.EPERM, "it leads out of the directory", str(output / name))
    fresh = not os.path.lexists(output)
    around = output.absolute().parent if fresh else output
    around.mkdir(parents=True, exist_ok=True)
    _clear(around)
    part = around / f".{output.absolute().name}.part{os.getpid()}"
    part.mkdir()
    try:
        _fill(part, imported)
        if fresh:
            part.rename(output)
        else:
            _move(sorted(p.relative_to(part) for p in part.rglob("*") if not p.is_dir()), part, output)
    finally:
        shutil.rmtree(part, ignore_errors=True)


def _fill(part: Path, imported: Imported) -> None:
    for name, text in imported.texts.items():
        path = part / name
        path.parent.mkdir(parents=True, exist_ok=True)
        mode = 0o600 if name in imported.private else 0o666
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, mode)
        with open(descriptor, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(descriptor)
    write_schemas(part / "schemas", check=False)


def _move(names: Iterable[Path], part: Path, output: Path) -> None:
    for name in names:
        (output / name).parent.mkdir(parents=True, exist_ok=True)
        os.replace(part / name, output / name)


def _clear(folder: Path) -> None:
    """Removes what killed imports left."""
    for path in folder.glob(".*"):
        found = _PART.fullmatch(path.name)
        if found and path.is_dir() and not path.is_symlink() and not os.path.exists(f"/proc/{found[1]}"):
            shutil.rmtree(path, ignore_errors=True)
