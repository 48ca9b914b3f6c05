"""What follows what is learnt from requests: from a trace at once, or from one after another as a robot runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from rorg.model.catalog import Request
from rorg.model.learned import Departure, Learned, Names
from rorg.model.trace import TraceEvent

PASSING = 1.0
"""Seconds. What is asked for so briefly is a step on the way to what comes next: a requester that releases one thing
and then requests another asked for nothing between."""
DEPARTURES = 200
"""The last ones that are kept of each state, so that habits of long ago are forgotten;"""
STATES = 64
"""the states of each requester, those that it was in last;"""
REQUESTERS = 64
"""and the requesters."""


@dataclass(frozen=True, slots=True)
class Left:
    """A state that a requester has left, before it is known for what. `since` is None where its beginning was not
    seen."""

    names: Names
    since: float | None
    at: float


@dataclass(frozen=True, slots=True)
class Stay:
    """What a requester asks for now, and since when by the clock of the loop."""

    names: Names
    since: float | None
    left: Left | None = None


@dataclass(frozen=True, slots=True)
class Learning:
    """What is known so far, and where each requester stands."""

    learned: Learned = Learned()
    stays: Mapping[str, Stay] = field(default_factory=dict)


def learn(events: Iterable[TraceEvent]) -> Learned:
    """What a trace teaches. Nothing is requested when it begins."""
    learning, held = Learning(), dict[str, dict[str, Names]]()
    for event in events:
        requests = held.setdefault(event.requester, {})
        requests[event.id] = event.services
        if event.requester not in learning.stays:
            learning = observe(learning, 0.0, event.requester, (), seen=True)
        learning = observe(learning, event.at, event.requester, _names(requests.values()))
    for requester, stay in learning.stays.items():
        learning = replace(learning, learned=_noted(learning.learned, requester, stay))
    return learning.learned


def observe(learning: Learning, at: float, requester: str, names: Names, seen: bool = False) -> Learning:
    """A requester asks for these from now on (`at`, seconds of any clock that goes forward). `seen`: it is known that
    it has just begun to, though nothing was known of it before."""
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
    """All that is asked for now, but for what manifests ask for as long as a requester runs. `first`: nobody has
    looked before, so it is not known since when."""
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
    """With the departure that led here, where it was seen whole."""
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
