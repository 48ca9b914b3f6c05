"""One attempt of a probe that asks this machine: tcp, http, files, the ROS master."""

from __future__ import annotations

import http.client
import ipaddress
import os
import socket
import time
import urllib.error
import urllib.request
from urllib.parse import urlsplit

from rorg.host.processes import process_start
from rorg.model.catalog import Probe
from rorg.probes import ros_master
from rorg.probes.answer import YES, Answer, no

TIMEOUT = 1.0
"""Seconds for one attempt."""

DIRECT = urllib.request.build_opener(urllib.request.ProxyHandler({}))
"""Past every proxy: what is asked are programs of this robot."""


def ask_socket(probe: Probe) -> Answer:
    """tcp and http."""
    try:
        if probe.kind == "tcp":
            host, _, port = str(probe.target).rpartition(":")
            with socket.create_connection((host, int(port)), timeout=TIMEOUT):
                return YES
        with DIRECT.open(str(probe.target), timeout=TIMEOUT):
            return YES
    except http.client.HTTPException as error:
        return no(f"{probe}: {type(error).__name__}")
    except urllib.error.HTTPError as error:
        return no(f"{probe.target} answers {error.code}")
    except OSError as error:
        reason = getattr(error, "reason", error)
        return no(f"{probe}: {getattr(reason, 'strerror', None) or reason}")


def ask_host(probe: Probe) -> Answer:
    """Everything that needs neither an engine nor a process; a file is one of this machine."""
    if probe.kind in ("tcp", "http"):
        return ask_socket(probe)
    if probe.kind == "file":
        return ask_file(probe, "interlock")
    return ros_master.probe(probe.kind, str(probe.target), probe.master)


def ask_file(probe: Probe, role: str, pid: int = 0, isolated: bool = False) -> Answer:
    """`pid` is the first process of the container, 0 where there is none; its file system is looked at where the
    engine gives it one of its own (`isolated`)."""
    path, root = str(probe.target), f"/proc/{pid}/root" if pid and isolated else ""
    try:
        written = os.stat(root + path).st_mtime
    except OSError as error:
        return no(f"file {path}: {error.strerror}")
    if role == "ready" and pid and written < process_start(pid) - 0.05:
        return no(f"file {path} is older than this run")
    age = time.time() - written
    if role == "live" and age > probe.interval:
        return no(f"file {path} was last touched {age:.0f} s ago")
    return YES


def asks_this_machine(probe: Probe) -> bool:
    """Whether what it asks is named as if it were on this machine: a port without a host, or localhost."""
    if probe.kind == "tcp":
        host = str(probe.target).rpartition(":")[0].strip("[]")
    else:
        host = urlsplit(probe.master if probe.kind.startswith("ros_") else str(probe.target)).hostname or ""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host in ("", "localhost") or host.endswith(".localhost")
