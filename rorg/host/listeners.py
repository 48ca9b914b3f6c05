"""Which process listens at a TCP port, and whose child it is."""

from __future__ import annotations

import psutil


def listening(port: int) -> int | None:
    """The process that listens at a port, in our network namespace; None where that is nobody, or nobody we may see."""
    return next(
        (
            c.pid
            for c in psutil.net_connections("tcp")
            if c.status == psutil.CONN_LISTEN and c.laddr and c.laddr.port == port and c.pid
        ),
        None,
    )


def lineage(pid: int | None) -> list[int]:
    """The process and its forebears, nearest first."""
    try:
        return [] if pid is None else [pid, *(p.pid for p in psutil.Process(pid).parents())]
    except psutil.Error:
        return []
