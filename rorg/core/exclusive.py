"""Exclusive resources, such as a microphone: which service holds them and who must let go. A paused service still holds
what it has open, because pausing closes no file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rorg.core.digest import rules_of
from rorg.core.observed import Container
from rorg.core.situation import Situation
from rorg.model.catalog import Service

Containers = Mapping[str, Sequence[Container]]
"""Service -> its containers, the current one first."""


class Exclusive:
    """Holders of exclusive resources in one situation. `undeclared` are containers of services that no manifest
    declares, or that are declared without a container."""

    def __init__(self, situation: Situation, containers: Containers, undeclared: Containers) -> None:
        self.s, self.desired, self.containers, self.undeclared = situation, situation.desired, containers, undeclared
        self.capacity = situation.desired.catalog.policy.resources

    def holders(self, service: Service, resource: str) -> list[str]:
        """Return the services that must let go of a resource before this service can begin."""
        users = [o for o in self.desired.sharers[resource] if o != service.name and self.alive(o)]
        left_over = self.left_over(resource)
        used = service.exclusive[resource] + sum(self.units(o, resource) for o in users) + sum(left_over.values())
        if used <= self.capacity.get(resource, 1):
            return []
        return [*(o for o in users if o not in self.s.wanted), *left_over] or users

    def contested(self, service: Service) -> bool:
        """Return whether this service holds a resource, even while paused, that a wanted service waits for."""
        for resource, units in service.exclusive.items():
            sharers = [o for o in self.desired.sharers[resource] if o != service.name]
            used = units + sum(self.units(o, resource) for o in sharers if self.alive(o))
            used += sum(self.left_over(resource).values())
            capacity = self.capacity.get(resource, 1)
            if any(
                used + (0 if self.alive(o) else self.units(o, resource)) > capacity
                for o in sharers
                if o in self.s.wanted and not self.done(o)
            ):
                return True
        return False

    def left_over(self, resource: str) -> dict[str, int]:
        """Return undeclared services that still hold units of a resource -> how many."""
        return {
            name: units
            for name, cs in self.undeclared.items()
            if self.alive(name) and (units := rules_of(cs[0].rules).exclusive.get(resource, 0))
        }

    def units(self, name: str, resource: str) -> int:
        return self.desired.catalog.services[name].exclusive[resource]

    def alive(self, name: str) -> bool:
        return any(c.alive for c in self.containers.get(name, ()))

    def done(self, name: str) -> bool:
        """Return whether a service ended and its restart policy does not restart it."""
        current = next(iter(self.containers.get(name, ())), None)
        service = self.desired.catalog.services[name]
        return current is not None and self.s.memory.of(name).over(service, current)
