"""Facts about the machine that rorg is installed on. Unknown facts are left out."""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
from pathlib import Path

from rorg.host.git_process import run_git
from rorg.model.installation import Space

UNSYNCHRONIZED = 0x40
"""STA_UNSYNC of adjtimex(2)."""
TIMEX = 208
"""Bytes of its structure; `status` follows `modes` and four longs, each in the place of a long."""
PATIENCE = 5.0


def writable(path: Path) -> str:
    """Why a directory can be neither used nor made; empty if it can."""
    place = path
    while not os.path.lexists(place) and place != place.parent:
        place = place.parent
    if not place.is_dir():
        return f"{place} is no directory"
    if not os.access(place, os.W_OK | os.X_OK):
        return f"you may not write to {place}"
    return ""


def space(path: Path) -> Space | None:
    """Of the file system that a path is on, or would be on; None if that is not known."""
    while not os.path.exists(path) and path != path.parent:
        path = path.parent
    try:
        filesystem = os.statvfs(path)
    except OSError:
        return None
    block = filesystem.f_frsize
    return Space(
        str(path),
        filesystem.f_bavail * block,
        filesystem.f_blocks * block,
        filesystem.f_favail if filesystem.f_files else 0,
    )


def git_version() -> str:
    """git's own text; empty if git is missing."""
    with contextlib.suppress(OSError):
        said = run_git(["--version"], None, PATIENCE)
        return said.text.strip() if said.yes else ""
    return ""


def clock_synchronized() -> bool | None:
    """Whether something keeps the clock right, by the kernel; None if it does not say."""
    buffer = (ctypes.c_long * (TIMEX // ctypes.sizeof(ctypes.c_long) + 8))()
    try:
        state = ctypes.CDLL(None, use_errno=True).adjtimex(ctypes.byref(buffer))
    except (OSError, AttributeError):
        return None
    if state < 0:
        return None
    status = ctypes.c_int.from_buffer(buffer, 5 * ctypes.sizeof(ctypes.c_long))
    return not status.value & UNSYNCHRONIZED


def open_files() -> int:
    """How many files this user's programs may have open at the same time."""
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    return most if most != resource.RLIM_INFINITY else 1 << 30
