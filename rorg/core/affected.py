"""Whom a restart, a hold or a release touches beside those that it names: what a person is told before it is done."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from rorg.core.admission import admit
from rorg.core.memory import Memory
from rorg.core.situation import Situation
from rorg.model.catalog import Catalog, Service


@dataclass(frozen=True, slots=True)
class Affected:
    """Who would be stopped. Services that do not run, and are not about to, are in neither."""

    drivers: tuple[str, ...] = ()
    """Of those that were named, the ones that move hardware."""
    along: Mapping[str, bool] = field(default_factory=dict)
    """Others, whether each moves hardware: what counts on the named ones, and drivers that nobody would ask for any
    more."""
    without: tuple[str, ...] = ()
    """Those that asked for what would be stopped, and go on without it."""

    @property
    def names(self) -> tuple[str, ...]:
        """All that a person must agree to; empty where nobody need be asked."""
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
    """Of a restart of these: what is restarted with them, one after another, and drivers that they alone request: a
    request ends with the run that sent it."""
    services = situation.desired.catalog.services
    restarted = _follow({n: s.restarts_with for n, s in services.items()}, names)
    requests = () if memory.admitted is None else memory.admitted.requests
    left = tuple(r for r in requests if r.requester not in restarted or r.standing or r.incarnation is None)
    excluded = {} if memory.admitted is None else memory.admitted.excluded
    return _found(
        situation, names, restarted, _drivers(situation, admit(situation.desired.catalog, left, excluded).wanted)
    )


def by_hold(situation: Situation, memory: Memory, names: Collection[str]) -> Affected:
    """Of a hold of these: what needs them, one after another, and drivers that only those request."""
    catalog: Catalog = situation.desired.catalog
    ceased = _follow({n: s.needs for n, s in catalog.services.items()}, names)
    requests = () if memory.admitted is None else memory.admitted.requests
    excluded = {} if memory.admitted is None else memory.admitted.excluded
    found = admit(catalog, requests, {**excluded, **dict.fromkeys(names, "held")})
    return _found(situation, names, ceased, _drivers(situation, found.wanted))


def by_release(situation: Situation, memory: Memory, key: tuple[str, str]) -> Affected:
    """Of the release of the request of a (requester, id): drivers that it names and nobody else asks for, and its
    requester where that is a service that runs and loses something. A driver that only goes along, since what needed it
    is released, ceases as its manifest says: nobody need be asked. Nobody, where there is no such request."""
    catalog, admitted = situation.desired.catalog, memory.admitted
    asked = next((r for r in admitted.requests if r.key == key and not r.standing), None) if admitted else None
    if admitted is None or asked is None:
        return Affected()
    found = admit(catalog, tuple(r for r in admitted.requests if r is not asked), admitted.excluded).wanted
    named = {m for name in asked.services for m in catalog.members(name)}
    gone = {n for n in _drivers(situation, found) & named if _touched(situation, catalog.services[n])}
    requester = catalog.services.get(asked.requester)
    loses = requester is not None and _touched(situation, requester) and any(n not in found for n in situation.wanted)
    return Affected(tuple(sorted(gone)), {}, (asked.requester,) if loses else ())


def _follow(counts_on: Mapping[str, Collection[str]], names: Collection[str]) -> set[str]:
    """These, and all that count on one of them."""
    found, pending = set(names), list(names)
    while pending:
        one = pending.pop()
        more = [n for n, others in counts_on.items() if one in others and n not in found]
        found.update(more)
        pending += more
    return found


def _drivers(situation: Situation, left: Collection[str]) -> set[str]:
    """Drivers that are wanted now and would not be any more."""
    services = situation.desired.catalog.services
    return {n for n in situation.wanted if n not in left and n in services and services[n].driver}


def _found(
    situation: Situation, names: Collection[str], stopped: Collection[str], unwanted: Collection[str]
) -> Affected:
    services = situation.desired.catalog.services
    drivers = tuple(n for n in names if services[n].driver and _touched(situation, services[n]))
    others = sorted({*stopped, *unwanted} - set(names))
    return Affected(drivers, {n: services[n].driver for n in others if _touched(situation, services[n])})


def _touched(situation: Situation, service: Service) -> bool:
    """It runs, or is about to."""
    there = situation.observed.by_service().get(service.name, ())
    return not service.meta and (service.name in situation.wanted or any(c.active for c in there))
