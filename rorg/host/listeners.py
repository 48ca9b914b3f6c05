"""Which process is at an end of a TCP connection, and whose child it is. A process in a network namespace of its own is
not found, nor one that we may not look at."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import psutil


def listening(port: int) -> int | None:
    """The process that listens at a port; None where that is nobody, or nobody we may see."""
    return _process(lambda c: c.status == psutil.CONN_LISTEN and c.laddr.port == port)


def calling(port: int, to: int) -> int | None:
    """The process that has a connection from a port of this machine to another; None as above."""
    return _process(lambda c: bool(c.raddr) and (c.laddr.port, c.raddr.port) == (port, to))


def _process(fits: Callable[[Any], bool]) -> int | None:
    return next((c.pid for c in psutil.net_connections("tcp") if c.laddr and c.pid and fits(c)), None)


def lineage(pid: int | None) -> list[int]:
    """The process and its forebears, nearest first."""
    try:
        return [] if pid is None else [pid, *(p.pid for p in psutil.Process(pid).parents())]
    except psutil.Error:
        return []
