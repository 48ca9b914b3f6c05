"""Temporary directories that do not outlive a killed process for long: the next one removes them."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path


@contextlib.contextmanager
def temporary_folder(prefix: str, within: str) -> Iterator[Path]:
    """A directory until the end of the block. Those of the same prefix whose process has died are removed first. Each
    is locked by its process, so that a live one is told from a dead one in every PID namespace."""
    _remove_dead(prefix, Path(within))
    place, descriptor = _made(prefix, within)
    try:
        yield place
    finally:
        _remove(place)
        os.close(descriptor)


def _made(prefix: str, within: str) -> tuple[Path, int]:
    while True:
        place = Path(tempfile.mkdtemp(prefix=prefix, dir=within))
        # Until it is locked, another process may take it for that of a dead one.
        with contextlib.suppress(FileNotFoundError):
            descriptor = _opened(place)
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            if place.is_dir():
                return place, descriptor
            os.close(descriptor)


def _remove_dead(prefix: str, within: Path) -> None:
    for place in within.glob(f"{prefix}*"):
        with contextlib.suppress(OSError):  # somebody else's, or gone by now
            descriptor = _opened(place)
            try:
                if os.fstat(descriptor).st_uid == os.geteuid():
                    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    _remove(place)
            finally:
                os.close(descriptor)


def _remove(place: Path) -> None:
    def again(function: Callable[[str], object], path: str, _: object) -> None:
        """What lies in a directory that may not be written."""
        with contextlib.suppress(OSError):
            os.chmod(os.path.dirname(path), 0o700)
            function(path)

    shutil.rmtree(place, onerror=again)


def _opened(place: Path) -> int:
    return os.open(place, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW | os.O_CLOEXEC)
