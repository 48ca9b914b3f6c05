"""The planner's view of a situation while it plans one service. It records whether the plan depends on the time or on
all containers, so that such a plan is made again in every pass."""

from __future__ import annotations

from collections.abc import Sequence

from rorg.core.exclusive import Containers, Exclusive
from rorg.core.observed import Container
from rorg.core.situation import Situation


class View:
    """A situation, seen from one service. Its plan may depend on the service itself and on related ones (see
    depending_plans in incremental.py). Reading `now` or `all_containers` adds a dependency on everything and marks the
    plan as `volatile`."""

    def __init__(self, situation: Situation, containers: Containers, exclusive: Exclusive) -> None:
        self.s, self.desired, self.containers, self.exclusive = situation, situation.desired, containers, exclusive
        self.volatile = False

    @property
    def now(self) -> float:
        self.volatile = True
        return self.s.now

    @property
    def all_containers(self) -> Sequence[Container]:
        self.volatile = True
        return self.s.observed.containers

    def of(self, service: str) -> Sequence[Container]:
        return self.containers.get(service, ())

    def current(self, service: str) -> Container | None:
        return next(iter(self.containers.get(service, ())), None)

    def starting(self, service: str) -> bool:
        """Return whether a call is under way that makes the service active."""
        flight = self.s.memory.in_flight.get(service)
        return flight is not None and flight.action.operation.begins

    def active(self, service: str) -> bool:
        return any(c.active for c in self.containers.get(service, ()))
