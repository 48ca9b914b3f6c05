"""The memory of this process."""

from __future__ import annotations

import ctypes
from contextlib import suppress

ARENA_MAX = -8
"""M_ARENA_MAX of glibc's malloc.h."""


def share_heap() -> None:
    """Make all threads of this process share one heap; call it before the first thread starts. By default glibc gives
    threads heaps of their own, up to eight for each core, and each keeps what was freed in it. Other C libraries have
    nothing like that."""
    with suppress(AttributeError, OSError):
        ctypes.CDLL(None).mallopt(ARENA_MAX, 1)
