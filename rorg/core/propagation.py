"""On which run of what it needs a run counts: so that a need that was restarted is told from one that was added."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from rorg.core.observed import Container
from rorg.model.catalog import Service


@dataclass(frozen=True, slots=True)
class CountedOn:
    """Of one run of a service: the runs of those needs whose restart restarts it (`needs: [{restart: true}]`)."""

    run: str = ""
    """Its own incarnation."""
    needs: Mapping[str, str] = field(default_factory=dict)
    """Need -> incarnation; "" for one that was restarted already when this was noticed."""

    def lost(self, need: str, container: Container, now: Container) -> bool:
        """The run of `container` counted on another run of the need than that of `now`."""
        counted_on = self.needs.get(need, now.incarnation)
        return not now.brief and self.run == container.incarnation and counted_on != now.incarnation


def counts_on(
    known: CountedOn,
    service: Service,
    current: Container | None,
    containers: Mapping[str, Sequence[Container]],
    begun: Mapping[str, str] | None,
) -> CountedOn:
    """Notes what a run counts on, once for each need: of a run that we began, what was there then (`begun`). Of one
    that is new to us the order of the starts tells, by the engine's clock: a service starts after what it needs. A
    need that is added later is taken as it is."""
    if current is None or not current.alive or current.brief:
        return known
    first = known.run != current.incarnation
    needs = (begun or {}) if first else known.needs
    needs = {n: run for n, run in needs.items() if n in service.restarts_with}
    for need in service.restarts_with:
        found = next(iter(containers.get(need, ())), None)
        if need in needs or found is None or not found.started_at:
            continue
        if first:
            needs[need] = found.incarnation if found.started_at <= current.started_at else ""
        elif found.alive:
            needs[need] = found.incarnation
    return known if not first and needs == known.needs else CountedOn(current.incarnation, needs)
