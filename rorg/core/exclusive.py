"""Exclusive resources: who holds them, and who is in whose way. What is paused still holds what it uses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rorg.core.digest import rules_of
from rorg.core.observed import Container
from rorg.core.situation import Situation
from rorg.model.catalog import Service

Containers = Mapping[str, Sequence[Container]]
"""Of each service, the one that counts first."""


class Exclusive:
    """Of one situation. `undeclared` are containers of services that no manifest declares, or not as having one."""

    def __init__(self, situation: Situation, containers: Containers, undeclared: Containers) -> None:
        self.s, self.desired, self.containers, self.undeclared = situation, situation.desired, containers, undeclared
        self.there = situation.desired.catalog.policy.resources

    def holders(self, service: Service, resource: str) -> list[str]:
        """Who must let go of a resource before this service can begin."""
        users = [o for o in self.desired.sharers[resource] if o != service.name and self.alive(o)]
        left = self.left_over(resource)
        used = service.exclusive[resource] + sum(self.units(o, resource) for o in users) + sum(left.values())
        if used <= self.there.get(resource, 1):
            return []
        return [*(o for o in users if o not in self.s.wanted), *left] or users

    def contested(self, service: Service) -> bool:
        """It holds a resource, even when paused, that a wanted service waits for."""
        for resource, units in service.exclusive.items():
            sharers = [o for o in self.desired.sharers[resource] if o != service.name]
            used = units + sum(self.units(o, resource) for o in sharers if self.alive(o))
            used += sum(self.left_over(resource).values())
            there = self.there.get(resource, 1)
            if any(
                used + (0 if self.alive(o) else self.units(o, resource)) > there
                for o in sharers
                if o in self.s.wanted and not self.done(o)
            ):
                return True
        return False

    def left_over(self, resource: str) -> dict[str, int]:
        """Services that no manifest declares any more, and still hold units of a resource."""
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
        """It ended, and its restart policy leaves it at that."""
        current = next(iter(self.containers.get(name, ())), None)
        service = self.desired.catalog.services[name]
        return current is not None and self.s.memory.of(name).over(service, current)
