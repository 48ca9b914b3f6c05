"""Learn what each requester asks for next, from a recorded trace or from requests as they come; predict from it which
services will be requested soon, and how soon they could be ready.

docs/explanation/planning.md explains the model, a Markov chain per requester.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

from rorg.core.plan import Action
from rorg.model.catalog import Catalog, Request
from rorg.model.graph import closure
from rorg.model.learned import Departure, Learned, Likelihood, Names
from rorg.model.trace import TraceEvent

START, RESUME = 2.0, 0.2
"""Seconds assumed until a service is ready after a start and after a resume, before any were measured."""
LOOK = 1.0
"""Seconds between two predictions, at least."""
EXACT = 1e-6
"""Seconds of tolerance. A deadline computed by addition and checked by subtraction may be off by a rounding error, and
the pass that it wakes must still find what it was made for."""
FEWEST = 5
"""Departures from a state below which nothing is predicted."""


@dataclass(frozen=True, slots=True)
class Warm:
    """A prewarmed service: wanted because it will probably be requested. Times are of the loop's clock."""

    likely: Likelihood
    """The probability when prewarming began."""
    until: float
    """When prewarming ends unless the request is still likely."""
    ran: bool = False
    """Whether it was seen running since."""


@dataclass(frozen=True, slots=True)
class PredictionState:
    """What prediction remembers between passes."""

    learning: Learning | None = None
    begun: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    """Service that is coming up -> (start or resume, since when)."""
    warm: Mapping[str, Warm] = field(default_factory=dict)
    failed: Mapping[str, float] = field(default_factory=dict)
    """Service that ended while it was warm -> when it may be prewarmed again."""

    @property
    def learned(self) -> Learned:
        return self.learning.learned if self.learning else Learned()


def with_begun(prediction: PredictionState, actions: Sequence[Action], now: float) -> PredictionState:
    """Start measuring how long services take to become ready after these actions."""
    coming = {a.service: (a.verb, now) for a in actions if a.operation.begins}
    if not coming or prediction.learning is None:
        return prediction
    return replace(prediction, begun={**prediction.begun, **coming})


def with_duration(learned: Learned, service: str, verb: str, seconds: float, declared: Collection[str]) -> Learned:
    """Note a measured duration as the mean of it and the last estimate: recent runs count most, so a change shows soon.
    Services that are no longer declared are forgotten."""
    took = {name: known for name, known in learned.took.items() if name in declared}
    known = took.get(service, {})
    mean = (known[verb] + seconds) / 2 if verb in known else seconds
    return replace(learned, took={**took, service: {**known, verb: round(mean, 3)}})


def predict(
    learning: Learning, catalog: Catalog, within: Mapping[str, float], now: float
) -> tuple[dict[str, Likelihood], float | None]:
    """Return the probability that each service in `within` is requested in so many seconds, and when to predict again.

    Among departures that stayed in the current state longer than it has lasted by now, the probability is the share
    that leads to the service in time. One extra departure is counted that does not lead to it, so that a few departures
    do not make a certainty. If several requesters may ask for a service, the highest probability counts.

    Predict again when the next departure comes within reach or has passed.
    """
    likelihoods, next_times, services_of = dict[str, Likelihood](), list[float](), dict[Names, frozenset[str]]()
    for requester, stay in learning.stays.items():
        departures = learning.learned.of(requester, stay.names)
        if stay.since is None or len(departures) < FEWEST:
            continue
        elapsed, hits, remaining = now - stay.since, dict[str, int](), 0
        for departure in departures:
            if departure.after <= elapsed:
                continue
            remaining += 1
            names = services_of.get(departure.to)
            if names is None:
                names = services_of[departure.to] = asked_for(catalog, departure.to) & within.keys()
            next_times += [stay.since + departure.after] if names else []
            for name in names:
                if departure.after <= elapsed + within[name] + EXACT:
                    hits[name] = hits.get(name, 0) + 1
                else:
                    next_times.append(stay.since + departure.after - within[name])
        for name, count in hits.items():
            probability = count / (remaining + 1)
            if name not in likelihoods or likelihoods[name].probability < probability:
                likelihoods[name] = Likelihood(requester, probability, within[name])
    return likelihoods, max(min(next_times), now + LOOK) if next_times else None


def asked_for(catalog: Catalog, names: Names) -> frozenset[str]:
    """Return services that are wanted when these are requested."""
    return frozenset(closure(catalog.services, [m for name in names for m in catalog.members(name)]))


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
