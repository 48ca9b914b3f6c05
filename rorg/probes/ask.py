"""One attempt of a probe that asks this machine: tcp, http, files, the ROS master."""

from __future__ import annotations

import ipaddress
import os
import time
from urllib.parse import urlsplit

from rorg.host.asking import answer, connect
from rorg.host.deadline import Deadline
from rorg.host.inside import modified
from rorg.host.processes import process_start
from rorg.model.catalog import Probe
from rorg.probes import ros_master
from rorg.probes.answer import YES, Answer, no

TIMEOUT = 1.0
"""Seconds for one attempt, all of it."""


def ask_socket(probe: Probe) -> Answer:
    """tcp and http. A redirect is an answer, as to the kubelet, and is not followed."""
    deadline = Deadline.within(TIMEOUT)
    try:
        if probe.kind == "tcp":
            host, _, port = str(probe.target).rpartition(":")
            connect(host.strip("[]"), int(port), deadline).close()
            return YES
        with answer(str(probe.target), deadline) as found:
            return YES if 200 <= found.status < 400 else no(f"{probe.target} answers {found.status}")
    except OSError as error:
        return no(f"{probe}: {error.strerror or error}")


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
    path = str(probe.target)
    try:
        written = modified(f"/proc/{pid}/root", path) if pid and isolated else os.stat(path).st_mtime
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
