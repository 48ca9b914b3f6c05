"""What a restart, hold or release affects besides the services it names. `rorg` shows this to a person and asks for
confirmation before acting, because a stopped driver may move hardware."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from rorg.core.admission import admit
from rorg.core.memory import Memory
from rorg.core.situation import Situation
from rorg.core.wanted import Wanted
from rorg.model.catalog import Request, Service


@dataclass(frozen=True, slots=True)
class Affected:
    """Services that would stop. Those that neither run nor are about to are left out."""

    drivers: tuple[str, ...] = ()
    """The named services that move hardware."""
    along: Mapping[str, bool] = field(default_factory=dict)
    """Other affected services -> whether they move hardware: services that depend on the named ones, and drivers that
    nothing else requests."""
    without: tuple[str, ...] = ()
    """Services that requested what would stop, and would go on without it."""

    @property
    def names(self) -> tuple[str, ...]:
        """All services that a person must confirm; empty if no confirmation is needed."""
        return (*self.drivers, *self.along, *self.without)

    def __str__(self) -> str:
        others = [f"{name} (moves hardware)" if driver else name for name, driver in self.along.items()]
        own = f"{', '.join(self.drivers)} {_verb(self.drivers, 'moves', 'move')} hardware" if self.drivers else ""
        along = f"{', '.join(others)} {_verb(others, 'goes', 'go')} along" if others else ""
        without = f"{', '.join(self.without)} asked for it, and would go on without" if self.without else ""
        return "; ".join(filter(None, (own, along, without)))


def _verb(names: Collection[str], one: str, several: str) -> str:
    return one if len(names) == 1 else several


def by_restart(situation: Situation, memory: Memory, names: Collection[str]) -> Affected:
    """Return what a restart of these services affects: services restarted with them, transitively, and drivers that
    only those request. A request ends with the run that sent it."""
    services = situation.desired.catalog.services
    restarted = dependants({n: s.restarts_with for n, s in services.items()}, names)
    left = [r for r in memory.admitted.requests if r.requester not in restarted or r.standing or r.incarnation is None]
    return _affected(situation, names, restarted, _still_wanted(situation, memory, left))


def by_hold(situation: Situation, memory: Memory, names: Collection[str]) -> Affected:
    """Return what a hold of these services affects: services that need them, transitively, and drivers that only those
    request."""
    ceased = dependants({n: s.needs for n, s in situation.desired.catalog.services.items()}, names)
    return _affected(situation, names, ceased, _still_wanted(situation, memory, memory.admitted.requests, names))


def by_release(situation: Situation, memory: Memory, key: tuple[str, str]) -> Affected:
    """Return what releasing the request (requester, id) affects: drivers that it names and no other request asks for,
    and its requester if that runs and loses a service. Empty if there is no such request.

    A driver that only ceases because what needed it was released is not listed: it ceases as its manifest says, so no
    confirmation is needed.
    """
    catalog, requests = situation.desired.catalog, memory.admitted.requests
    asked = next((r for r in requests if r.key == key and not r.standing), None)
    if asked is None:
        return Affected()
    still_wanted = _still_wanted(situation, memory, [r for r in requests if r is not asked])
    named = {m for name in asked.services for m in catalog.members(name)}
    stopping = {n for n in _drivers(situation, still_wanted) & named if _touched(situation, catalog.services[n])}
    requester = catalog.services.get(asked.requester)
    loses = (
        requester is not None
        and _touched(situation, requester)
        and any(n not in still_wanted for n in situation.wanted)
    )
    return Affected(tuple(sorted(stopping)), {}, (asked.requester,) if loses else ())


def dependants(counts_on: Mapping[str, Collection[str]], names: Collection[str]) -> set[str]:
    """Return these services and everything that depends on one of them, transitively."""
    affected, pending = set(names), list(names)
    while pending:
        name = pending.pop()
        more = [n for n, needs in counts_on.items() if name in needs and n not in affected]
        affected.update(more)
        pending += more
    return affected


def _still_wanted(
    situation: Situation, memory: Memory, requests: Collection[Request], held: Collection[str] = ()
) -> Wanted:
    """Return what would be wanted if only these requests were left, and these services were held too."""
    excluded = {**memory.admitted.excluded, **dict.fromkeys(held, "held")}
    return admit(situation.desired.catalog, requests, excluded).wanted


def _drivers(situation: Situation, left: Collection[str]) -> set[str]:
    """Return drivers that are wanted now and would not be any more."""
    services = situation.desired.catalog.services
    return {n for n in situation.wanted if n not in left and n in services and services[n].driver}


def _affected(situation: Situation, names: Collection[str], stopped: Collection[str], still_wanted: Wanted) -> Affected:
    services = situation.desired.catalog.services
    drivers = tuple(n for n in names if services[n].driver and _touched(situation, services[n]))
    along = sorted({*stopped, *_drivers(situation, still_wanted)} - set(names))
    return Affected(drivers, {n: services[n].driver for n in along if _touched(situation, services[n])})


def _touched(situation: Situation, service: Service) -> bool:
    """Return whether a service runs or is about to."""
    active = any(c.active for c in situation.observed.of(service.name))
    return not service.meta and (service.name in situation.wanted or active)
