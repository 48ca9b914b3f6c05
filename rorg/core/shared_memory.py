"""What Fast DDS keeps in shared memory: whose it may be, and which of its files belong together."""

from __future__ import annotations

import re
from collections.abc import Mapping

from rorg.core.observed import Observed
from rorg.model.catalog import Service
from rorg.model.ros import declares_ros2

FILE = re.compile(r"(?:sem\.)?((?:fastrtps|fastdds|fast_datasharing)_.+?)(?:_el|_sl|_mutex)?")
"""A segment or a port of its transport, with the locks and the semaphore beside it."""


def group_of(name: str) -> str:
    """The segment or port that a file of /dev/shm belongs to, by its name; empty where it is not Fast DDS's."""
    found = FILE.fullmatch(name)
    return found[1] if found else ""


def participants(services: Mapping[str, Service]) -> frozenset[str]:
    """Services of ROS 2 that use the machine's own shared memory."""
    specs = {name: service.spec for name, service in services.items() if service.spec is not None}
    return frozenset(
        name
        for name, spec in specs.items()
        if spec.get("ipc") == "host" and declares_ros2(spec.get("environment") or ())
    )


def none_runs(participants: frozenset[str], services: Mapping[str, Service], observed: Observed) -> bool:
    """Whether no participant lives. What no manifest declares any more may be one."""
    alive = (c.service for c in observed.containers if c.alive)
    return observed.complete and not any(name in participants or name not in services for name in alive)
