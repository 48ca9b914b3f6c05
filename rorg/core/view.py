"""What one look at a service goes by: the situation, and a note of whether the look has to be repeated."""

from __future__ import annotations

from collections.abc import Sequence

from rorg.core.exclusive import Containers, Exclusive
from rorg.core.observed import Container
from rorg.core.situation import Situation


class View:
    """Of one situation, for one service. What a service's plan depends on is the service itself, its neighbours (see
    onward.py), and what is asked for by `now` and `all_containers`: these make it `volatile`, so that it is looked at
    again in every pass."""

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
        """Whether a call is under way upon which it is active."""
        flight = self.s.memory.in_flight.get(service)
        return flight is not None and flight.action.operation.begins

    def active(self, service: str) -> bool:
        return any(c.active for c in self.containers.get(service, ()))
