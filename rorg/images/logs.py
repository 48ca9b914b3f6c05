"""The logs of builds: `STATE/builds/NAME-IDENTITY.log`, of each image the last ones."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path

from rorg.images.order import Order
from rorg.model.image_names import SHORT
from rorg.store.files import make_directory, regular

KEPT = 5
"""Logs of one image."""
PRIVATE = 0o600
"""Build arguments may be secrets."""


@contextlib.contextmanager
def build_log(folder: Path | None, order: Order) -> Iterator[Callable[[str], None]]:
    """Takes all that a build says, whatever whoever hears of it is shown. Raises OSError."""
    if folder is None:
        with open(os.devnull, "w") as nothing:
            yield lambda text: print(text, file=nothing)
        return
    make_directory(folder, 0o700)
    descriptor = regular(Path(log_path(folder, order)), os.O_WRONLY | os.O_CREAT)
    os.fchmod(descriptor, PRIVATE)
    os.ftruncate(descriptor, 0)
    with open(descriptor, "w", encoding="utf-8", errors="replace", buffering=1) as file:
        _remove_old(folder, order.log_name[0])
        yield lambda text: print(text, file=file, end="" if text.endswith("\n") else "\n")


def log_path(folder: Path | None, order: Order) -> str:
    """The file of it; empty where logs have no folder."""
    stem, identity = order.log_name
    return str(folder / f"{stem}-{identity}.log") if folder else ""


def _remove_old(folder: Path, stem: str) -> None:
    name = re.compile(rf"{re.escape(stem)}-(latest|[0-9a-f]{{{SHORT}}})\.log")
    found = sorted((p for p in folder.iterdir() if name.fullmatch(p.name)), key=lambda p: p.stat().st_mtime_ns)
    for path in found[:-KEPT]:
        path.unlink(missing_ok=True)
