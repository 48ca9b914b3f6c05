"""One attempt of a probe that asks this machine: tcp, http, files, the ROS master."""

from __future__ import annotations

import ipaddress
import os
from dataclasses import replace
from urllib.parse import urlsplit

from rorg.host.bounded_http import answer, connect
from rorg.host.deadline import Deadline
from rorg.model.probe import Probe
from rorg.probes import ros_master
from rorg.probes.answer import YES, Answer, no

TIMEOUT = 1.0
"""Seconds for one whole attempt."""


def ask_socket(probe: Probe) -> Answer:
    """tcp and http. A redirect counts as an answer, as for the kubelet, and is not followed."""
    deadline = Deadline.within(TIMEOUT)
    try:
        if probe.kind == "tcp":
            host, _, port = str(probe.target).rpartition(":")
            connect(host.strip("[]"), int(port), deadline).close()
            return YES
        with answer(str(probe.target), deadline) as response:
            return YES if 200 <= response.status < 400 else no(f"{probe.target} answers {response.status}")
    except OSError as error:
        return no(f"{probe}: {error.strerror or error}")


def ask_host(probe: Probe) -> Answer:
    """Every probe that needs neither an engine nor a process; a file is one of this machine."""
    if probe.kind in ("tcp", "http"):
        return ask_socket(probe)
    if probe.kind == "file":
        return ask_file(probe)
    return ros_master.probe(probe.kind, str(probe.target), probe.graph)


def ask_file(probe: Probe) -> Answer:
    """Return whether a file of this machine exists."""
    try:
        os.stat(str(probe.target))
    except OSError as error:
        return no(f"file {probe.target}: {error.strerror}")
    return YES


def asks_this_machine(probe: Probe) -> bool:
    """Whether the probe names this machine: a port without a host, or localhost."""
    if probe.kind == "tcp":
        host = str(probe.target).rpartition(":")[0].strip("[]")
    else:
        host = urlsplit(probe.graph or str(probe.target)).hostname or ""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host in ("", "localhost") or host.endswith(".localhost")


def at(probe: Probe, host: str) -> Probe:
    """Return a tcp or http probe of the same port on another host."""
    shown = f"[{host}]" if ":" in host else host
    if probe.kind == "tcp":
        return replace(probe, target=f"{shown}:{str(probe.target).rpartition(':')[2]}")
    url = urlsplit(str(probe.target))
    return replace(probe, target=url._replace(netloc=f"{shown}:{url.port}" if url.port else shown).geturl())
