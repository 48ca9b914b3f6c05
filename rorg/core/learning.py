"""Learn what each requester asks for next, from a recorded trace or from requests as they come."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from rorg.model.catalog import Request
from rorg.model.learned import Departure, Learned, Names
from rorg.model.trace import TraceEvent

PASSING = 1.0
"""Seconds. A shorter state is only a step between two others: a requester that releases one thing and then requests the
next did not ask for nothing in between."""
DEPARTURES = 200
"""Limits on what is kept, so that old habits are forgotten and memory stays bounded: departures per state,"""
STATES = 64
"""states per requester,"""
REQUESTERS = 64
"""and requesters; the most recent ones are kept."""


@dataclass(frozen=True, slots=True)
class Left:
    """A state that a requester has left, and for which it is not known yet where it leads. `since` is None if its
    beginning was not observed."""

    names: Names
    since: float | None
    at: float


@dataclass(frozen=True, slots=True)
class Stay:
    """What a requester asks for now, and since when by the loop's clock."""

    names: Names
    since: float | None
    left: Left | None = None


@dataclass(frozen=True, slots=True)
class Learning:
    """The model so far, and the present state of each requester."""

    learned: Learned = Learned()
    stays: Mapping[str, Stay] = field(default_factory=dict)


def learn(events: Iterable[TraceEvent]) -> Learned:
    """Learn from a whole trace, which begins with no requests."""
    learning, requests_of = Learning(), dict[str, dict[str, Names]]()
    for event in events:
        requests = requests_of.setdefault(event.requester, {})
        requests[event.id] = event.services
        if event.requester not in learning.stays:
            learning = observe(learning, 0.0, event.requester, (), seen=True)
        learning = observe(learning, event.at, event.requester, _names(requests.values()))
    for requester, stay in learning.stays.items():
        learning = replace(learning, learned=_noted(learning.learned, requester, stay))
    return learning.learned


def observe(learning: Learning, at: float, requester: str, names: Names, seen: bool = False) -> Learning:
    """Note that a requester asks for these names from `at` on (seconds of any clock that never goes back). `seen` means
    that it is known to have just begun, even if nothing was known about this requester."""
    stay = learning.stays.get(requester)
    if stay is None:
        return _with(learning, requester, Stay(names, at if seen else None))
    if stay.names == names:
        return learning
    left = stay.left
    if left is not None and at - left.at < PASSING:
        back = left.names == names
        return _with(learning, requester, Stay(names, left.since) if back else Stay(names, at, left))
    learning = replace(learning, learned=_noted(learning.learned, requester, stay))
    return _with(learning, requester, Stay(names, at, Left(stay.names, stay.since, at)))


def observe_requests(learning: Learning, at: float, requests: Iterable[Request], first: bool = False) -> Learning:
    """Note all current requests, except those that manifests make for a requester as long as it runs. `first`: this is
    the first look, so nothing is known about how long the requests exist."""
    asked: dict[str, list[Names]] = {requester: [] for requester in learning.stays}
    for request in requests:
        if not request.standing:
            asked.setdefault(request.requester, []).append(request.services)
    for requester, services in asked.items():
        learning = observe(learning, at, requester, _names(services), seen=not first)
    return learning


def _names(services: Iterable[Names]) -> Names:
    return tuple(sorted({name for names in services for name in names}))


def _with(learning: Learning, requester: str, stay: Stay) -> Learning:
    stays = {**learning.stays, requester: stay}
    if len(stays) > REQUESTERS:
        stays.pop(next(iter(stays)))
    return replace(learning, stays=stays)


def _noted(learned: Learned, requester: str, stay: Stay) -> Learned:
    """Return what was learnt, with the departure that led to this state, if the state before was observed from its
    beginning."""
    left = stay.left
    if left is None or left.since is None:
        return learned
    states = dict(learned.departures.get(requester, {}))
    before = states.pop(left.names, ())
    states[left.names] = (*before, Departure(left.at - left.since, stay.names))[-DEPARTURES:]
    departures = {**learned.departures}
    departures.pop(requester, None)
    departures[requester] = dict(list(states.items())[-STATES:])
    return replace(learned, departures=dict(list(departures.items())[-REQUESTERS:]))
