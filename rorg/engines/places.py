"""Where a copied file or directory goes, on every engine: as with cp -r."""

from __future__ import annotations

import contextlib
import os
import tarfile
from collections.abc import Iterator
from pathlib import Path

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
    except tarfile.FilterError as error:
        remedy = "`rorg exec SERVICE -- tar c PATH | tar x`, if you trust it"
        raise Invalid(what, f"'{error.tarinfo.name}' leads out of it", remedy) from error
    except (FileNotFoundError, FileExistsError, NotADirectoryError, IsADirectoryError, PermissionError) as error:
        raise Invalid(what, f"{error.filename}: {error.strerror}", "another place") from error
    except tarfile.TarError as error:
        raise Invalid(what, f"what the engine sent is not an archive: {error}") from error
