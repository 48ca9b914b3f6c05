"""One attempt of a probe that asks this machine: tcp, http, files, the ROS master."""

from __future__ import annotations

import http.client
import os
import socket
import time
import urllib.error
import urllib.request

from rorg.host.processes import process_start
from rorg.model.catalog import Probe
from rorg.probes import ros_master

TIMEOUT = 1.0
"""Seconds for one attempt."""

DIRECT = urllib.request.build_opener(urllib.request.ProxyHandler({}))
"""Past every proxy: what is asked are programs of this robot."""


class CannotAsk(Exception):
    """Nothing was learnt of the service: who would have to be asked does not answer."""


def ask_socket(probe: Probe) -> str:
    """tcp and http."""
    try:
        if probe.kind == "tcp":
            host, _, port = str(probe.target).rpartition(":")
            with socket.create_connection((host, int(port)), timeout=TIMEOUT):
                return ""
        with DIRECT.open(str(probe.target), timeout=TIMEOUT):
            return ""
    except http.client.HTTPException as error:
        return f"{probe}: {type(error).__name__}"
    except urllib.error.HTTPError as error:
        return f"{probe.target} answers {error.code}"
    except OSError as error:
        reason = getattr(error, "reason", error)
        return f"{probe}: {getattr(reason, 'strerror', None) or reason}"


def ask_host(probe: Probe, pid: int = 0, role: str = "ready", isolated: bool = False) -> str:
    """Everything that needs no engine. `pid` is the first process of the container, 0 where there is none; its file
    system is looked at where the engine gives it one of its own."""
    if probe.kind in ("tcp", "http"):
        return ask_socket(probe)
    if probe.kind == "file":
        root = f"/proc/{pid}/root" if pid and isolated else ""
        return _ask_file(str(probe.target), root, pid, role, probe.interval)
    return ros_master.probe(probe.kind, str(probe.target), probe.master)


def _ask_file(path: str, root: str, pid: int, role: str, interval: float) -> str:
    try:
        written = os.stat(root + path).st_mtime
    except OSError as error:
        return f"file {path}: {error.strerror}"
    if role == "ready" and pid and written < process_start(pid) - 0.05:
        return f"file {path} is older than this run"
    age = time.time() - written
    if role == "live" and age > interval:
        return f"file {path} was last touched {age:.0f} s ago"
    return ""
