"""Predict which services will be requested soon, from what was learnt about each requester, and how soon they could be
ready.

docs/explanation/planning.md explains the model, a Markov chain per requester.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

from rorg.core.learning import Learning
from rorg.core.plan import Action
from rorg.model.catalog import Catalog, Request
from rorg.model.graph import closure
from rorg.model.learned import Learned, Likelihood, Names

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
    requests: tuple[Request, ...] = ()
    """The requests of the last pass."""
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
