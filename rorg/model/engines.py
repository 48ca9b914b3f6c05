"""The engines that rorg knows, and what each can do: the only place outside of engines/ that names one.

Values only, so that commands, checks of manifests and the planner can ask without loading an engine. A NamedTuple,
because every command imports this and dataclasses would double the time that this takes.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple


class Capabilities(NamedTuple):
    """The abilities of an engine. rorg reports the ones that it lacks, and uses the next best way if there is one."""

    server: bool = True
    """It is a program of its own, which can be stopped or stuck."""
    isolation: bool = True
    """Containers have namespaces; otherwise they are plain processes of this machine."""
    images: bool = True
    """Containers are made from images that must be built or pulled; otherwise an image is only a name."""
    pause: bool = True
    """Without it, services with `idle: {action: pause}` are stopped."""
    rename: bool = True
    """Without it, a new container keeps the name that it was created with."""
    update: bool = True
    """Live options can be set in place; without it, a change of one makes a new container."""
    exec: bool = True
    """Commands run inside a container; without it, `exec` probes cannot be asked."""
    logs: bool = True
    """It keeps what containers print."""
    log_times: bool = True
    """It knows when a line was printed."""
    events: bool = True
    """It reports all changes immediately; without it, some or all are found by the next list."""
    stats: bool = True
    """It knows what containers use of CPU and memory."""
    rolls: bool = False
    """The start of a service's new container ends the previous one, as one rolling update."""
    bulk: int | None = None
    """How many calls for bulk work it takes at a time, if they do not load this machine."""
    options: frozenset[str] | None = None
    """Fields of a spec, devices among them, that have an effect or whose effect is there anyway; None for all."""

    def ignored(self, options: frozenset[str]) -> frozenset[str]:
        """Those of these options that have no effect."""
        return frozenset() if self.options is None else options - self.options


DEFAULT_ENGINE = "docker"
SWARM = "swarm"
"""The engine of services that may run anywhere."""
ENGINES: Mapping[str, Capabilities] = {
    DEFAULT_ENGINE: Capabilities(),
    "process": Capabilities(
        server=False,
        isolation=False,
        images=False,
        log_times=False,
        events=False,
        options=frozenset(
            (
                *("image", "command", "entrypoint", "environment", "inherit_environment", "working_dir", "labels"),
                *("stop_signal", "stop_grace_period", "container_name", "init", "network_mode", "logging"),
            )
        ),
    ),
    SWARM: Capabilities(
        images=False,
        pause=False,
        rename=False,
        update=False,
        exec=False,
        events=False,
        stats=False,
        rolls=True,
        bulk=16,
        options=frozenset(
            (
                *("image", "command", "entrypoint", "environment", "working_dir", "labels", "user", "group_add"),
                *("hostname", "extra_hosts", "dns", "dns_opt", "dns_search", "network_mode", "networks", "ports"),
                *("cap_add", "cap_drop", "sysctls", "ulimits", "init", "read_only", "isolation", "tty", "stdin_open"),
                *("cpus", "mem_limit", "pids_limit", "shm_size", "tmpfs", "volumes", "healthcheck", "logging"),
                *("stop_signal", "stop_grace_period", "container_name", "restart", "placement", "reserve"),
            )
        ),
    ),
}
"""By name, in the order in which they are tried when none is chosen."""


def capabilities_of(engine: str) -> Capabilities:
    """The capabilities of the engine of this name; all of them if the name is not known."""
    return ENGINES.get(engine, Capabilities())
