"""Copies files into and out of the folder of a plain process."""

from __future__ import annotations

import shutil
from pathlib import Path

from rorg.engines.places import place_of, refused
from rorg.errors import Invalid


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
