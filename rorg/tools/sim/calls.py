"""Calls of the sim engine: how long they take, and how they fail on demand."""

from __future__ import annotations

from collections.abc import Mapping, MutableMapping
from dataclasses import dataclass, field, replace

from rorg.core.observed import Container
from rorg.errors import EngineError

LATENCY: Mapping[str, float] = {
    "create": 0.014,
    "start": 0.088,
    "pause": 0.013,
    "resume": 0.013,
    "activate": 0.010,
    "deactivate": 0.010,
    "stop": 0.047,
    "remove": 0.028,
    "rename": 0.005,
    "update": 0.010,
    "signal": 0.005,
}
"""Seconds that each call of the engine takes: medians measured with Docker 20.10 on a 2-core machine."""
UNSUPPORTED = "not supported"
"""The message of a fault that counts as a call that an engine does not support."""


@dataclass
class Faults:
    """Faults to simulate. Keys are (verb, service)."""

    hang: dict[tuple[str, str], float] = field(default_factory=dict)
    """Additional seconds that a call takes."""
    fail: dict[tuple[str, str], list[str]] = field(default_factory=dict)
    """Messages of the next failures, each used once."""
    spent: set[str] = field(default_factory=set)
    """Containers that cannot be started again."""
    unremovable: dict[str, str] = field(default_factory=dict)
    """Container that the engine cannot remove -> the state in which that leaves it: `removing` or `dead`."""
    crash_after: dict[str, float] = field(default_factory=dict)
    """Service -> seconds after each start until it exits."""
    exit_code: int = 1
    bad: dict[str, str] = field(default_factory=dict)
    """Digest -> how its containers fail: they refuse to `start`, or `exit` soon after the start."""
    unreachable: bool = False

    def keep(self, containers: MutableMapping[str, Container], container: str) -> None:
        """Refuse to remove a container that cannot be removed. Raises EngineError."""
        if state := self.unremovable.get(container):
            containers[container] = replace(containers[container], state=state)
            raise EngineError(f"remove {container[:12]}", "device or resource busy")
