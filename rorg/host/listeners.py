"""Finds the process at an end of a TCP connection, and its ancestors. Processes in their own network namespace, and
those that we may not look at, are not found."""

from __future__ import annotations

import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil

TABLES = ("/proc/net/tcp", "/proc/net/tcp6")
LISTENS = "0A"
"""State of a listening socket in these tables (proc(5))."""


def open_ports() -> frozenset[int]:
    """TCP ports of this machine with a listener, found without looking at processes."""
    ports = set[int]()
    for table in TABLES:
        try:
            lines = Path(table).read_text().splitlines()[1:]
        except OSError:
            continue  # this protocol is missing here
        rows = (line.split() for line in lines)
        ports.update(int(row[1].rpartition(":")[2], 16) for row in rows if row[3] == LISTENS)
    return frozenset(ports)


def listeners() -> dict[int, int]:
    """The process that listens at each TCP port, as far as we may see it."""
    connections = psutil.net_connections("tcp")
    return {c.laddr.port: c.pid for c in connections if c.laddr and c.pid and c.status == psutil.CONN_LISTEN}


def listening(port: int) -> int | None:
    """The process that listens at a port; None if there is none, or none that we may see."""
    return _process(lambda c: c.status == psutil.CONN_LISTEN and c.laddr.port == port)


def calling(port: int, to: int) -> int | None:
    """The process that has a connection from a port of this machine to another; None as above."""
    return _process(lambda c: bool(c.raddr) and (c.laddr.port, c.raddr.port) == (port, to))


def _process(fits: Callable[[Any], bool]) -> int | None:
    return next((c.pid for c in psutil.net_connections("tcp") if c.laddr and c.pid and fits(c)), None)


def lineage(pid: int | None) -> list[int]:
    """The process and its ancestors, nearest first."""
    try:
        return [] if pid is None else [pid, *(p.pid for p in psutil.Process(pid).parents())]
    except psutil.Error:
        return []


def own_names() -> frozenset[str]:
    """Names and addresses of this machine, in small letters. Asks no name server."""
    addresses = (a.address.partition("%")[0] for interface in psutil.net_if_addrs().values() for a in interface)
    return frozenset(name.lower() for name in ("localhost", "127.0.1.1", "::1", socket.gethostname(), *addresses))
