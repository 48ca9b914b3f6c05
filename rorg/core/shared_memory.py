"""Files of Fast DDS (ROS 2) in shared memory: which of them belong together, and whether a service may still use them.
A killed participant leaves its files in /dev/shm."""

from __future__ import annotations

import re
from collections.abc import Mapping

from rorg.core.observed import Observed
from rorg.model.catalog import Service
from rorg.model.ros import declares_ros2

FILE = re.compile(r"(?:sem\.)?((?:fastrtps|fastdds|fast_datasharing)_.+?)(?:_el|_sl|_mutex)?")
"""A segment or port of its transport, with its locks and semaphore."""


def group_of(name: str) -> str:
    """Return the segment or port that a file of /dev/shm belongs to; "" if it is not Fast DDS's."""
    match = FILE.fullmatch(name)
    return match[1] if match else ""


def participants(services: Mapping[str, Service]) -> frozenset[str]:
    """Return ROS 2 services that use the host's shared memory."""
    specs = {name: service.spec for name, service in services.items() if service.spec is not None}
    return frozenset(
        name
        for name, spec in specs.items()
        if spec.get("ipc") == "host" and declares_ros2(spec.get("environment") or ())
    )


def none_runs(participants: frozenset[str], services: Mapping[str, Service], observed: Observed) -> bool:
    """Return whether no participant is alive. An undeclared container may be one."""
    alive = (c.service for c in observed.containers if c.alive)
    return observed.complete and not any(name in participants or name not in services for name in alive)
