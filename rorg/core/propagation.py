"""Restart propagation: which runs of its needs a run relies on. It tells a need that was restarted from one that was
only added to the manifest. A ROS node is lost to the graph when roscore restarts, so it must restart too."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from rorg.core.observed import Container
from rorg.model.catalog import Service


@dataclass(frozen=True, slots=True)
class CountedOn:
    """The runs of needs on which one run of a service relies, for needs declared with `restart: true`."""

    run: str = ""
    """The service's own incarnation."""
    needs: Mapping[str, str] = field(default_factory=dict)
    """Need -> incarnation; "" if it was already restarted when this was noticed."""

    def lost(self, need: str, container: Container, now: Container) -> bool:
        """Return whether the run of `container` relied on a run of the need that is over."""
        counted_on = self.needs.get(need, now.incarnation)
        return not now.brief and self.run == container.incarnation and counted_on != now.incarnation


def counts_on(
    known: CountedOn,
    service: Service,
    current: Container | None,
    containers: Mapping[str, Sequence[Container]],
    begun: Mapping[str, str] | None,
) -> CountedOn:
    """Note what a run relies on, once per need.

    For a run that rorg began, these are the runs at that time (`begun`). For a run that rorg finds, the engine's start
    times decide: a service starts after its needs. A need that is added later is taken as it is.
    """
    if current is None or not current.alive or current.brief:
        return known
    first = known.run != current.incarnation
    needs = (begun or {}) if first else known.needs
    needs = {n: run for n, run in needs.items() if n in service.restarts_with}
    for need in service.restarts_with:
        container = next(iter(containers.get(need, ())), None)
        if need in needs or container is None or not container.started_at:
            continue
        if first:
            needs[need] = container.incarnation if container.started_at <= current.started_at else ""
        elif container.alive:
            needs[need] = container.incarnation
    return known if not first and needs == known.needs else CountedOn(current.incarnation, needs)
