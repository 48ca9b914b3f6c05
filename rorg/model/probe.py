"""How rorg finds out whether a service is ready, alive, or may be touched."""

from __future__ import annotations

from dataclasses import dataclass

from rorg.model.units import LONGEST

ROS_KINDS = frozenset(("ros_node", "ros_topic", "ros_rate", "ros_service", "ros_action", "ros_parameter", "lifecycle"))
"""Kinds of probes that look at a ROS graph."""


@dataclass(frozen=True, slots=True)
class Probe:
    """A probe of a service: `ready`, `live` or `interlock`."""

    kind: str
    """delay, completed, tcp, http, file, exec, log, engine, ros_parameters or one of ROS_KINDS; all for several."""
    target: float | str | tuple[str, ...]
    """For ros_rate (topic, messages a second), for lifecycle (node, state)."""
    timeout: float = 30.0
    """Seconds after which a service counts as late."""
    interval: float = 0.25
    """Seconds between two probes."""
    failures: int = 0
    """Failures in a row that count; 0 if readiness is not probed again."""
    graph: str = ""
    """Name of the ROS graph, for ROS_KINDS."""
    parts: tuple[Probe, ...] = ()
    """Probes that must all hold; `interval` is then the shortest of theirs."""

    @property
    def questions(self) -> tuple[Probe, ...]:
        """The single questions: its parts, or itself."""
        return self.parts or (self,)

    @property
    def delay(self) -> float | None:
        """Seconds after which a `delay` holds; None for other kinds. A task never becomes ready by running, so its
        delay is the longest one."""
        if self.completed:
            return LONGEST
        return float(self.target) if self.kind == "delay" and not isinstance(self.target, tuple) else None

    @property
    def completed(self) -> bool:
        """Whether it belongs to a task, which others wait for until it has ended successfully."""
        return self.kind == "completed"

    def __str__(self) -> str:
        if self.parts:
            return " and ".join(map(str, self.parts))
        if self.completed:
            return self.kind
        target = " ".join(self.target) if isinstance(self.target, tuple) else self.target
        return f"{self.kind} {target}"
