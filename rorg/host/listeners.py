"""Which process is at an end of a TCP connection, and whose child it is. A process in a network namespace of its own is
not found, nor one that we may not look at."""

from __future__ import annotations

import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil

TABLES = ("/proc/net/tcp", "/proc/net/tcp6")
LISTENS = "0A"
"""The state of a socket that listens, in these tables (proc(5))."""


def open_ports() -> frozenset[int]:
    """TCP ports of this machine at which somebody listens, whoever that is. Looks at no process."""
    found = set[int]()
    for table in TABLES:
        try:
            lines = Path(table).read_text().splitlines()[1:]
        except OSError:
            continue  # no such protocol here
        rows = (line.split() for line in lines)
        found.update(int(row[1].rpartition(":")[2], 16) for row in rows if row[3] == LISTENS)
    return frozenset(found)


def listeners() -> dict[int, int]:
    """The process at each TCP port at which one listens that we may see."""
    found = psutil.net_connections("tcp")
    return {c.laddr.port: c.pid for c in found if c.laddr and c.pid and c.status == psutil.CONN_LISTEN}


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


def own_names() -> frozenset[str]:
    """Names and addresses by which programs of this machine are told to be here, in small letters. Asks no name
    server."""
    addresses = (a.address.partition("%")[0] for found in psutil.net_if_addrs().values() for a in found)
    return frozenset(name.lower() for name in ("localhost", "127.0.1.1", "::1", socket.gethostname(), *addresses))
