"""Which services will be requested soon, by what was learnt of their requesters; and how soon they could be ready."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace

from rorg.core.learning import Learning
from rorg.core.plan import Action
from rorg.model.catalog import Catalog, Request
from rorg.model.graph import closure
from rorg.model.learned import Learned, Likelihood, Names

START, RESUME = 2.0, 0.2
"""Seconds that a service is thought to take until it is ready, before that was measured."""
LOOK = 1.0
"""Seconds between two looks at what is likely, at the least."""
EXACT = 1e-6
"""Seconds: a look at a time that was computed the other way round must find what it was made for."""
FEWEST = 5
"""Departures from a state, below which nothing is concluded."""


@dataclass(frozen=True, slots=True)
class Warm:
    """A service that is wanted since it is likely to be requested. Times are of the loop's clock."""

    likely: Likelihood
    """As it was when this began."""
    until: float
    """It is given up then, unless it is likely still."""
    ran: bool = False
    """It was seen to run since."""


@dataclass(frozen=True, slots=True)
class Foresight:
    """What is remembered of it from one pass to the next."""

    learning: Learning | None = None
    requests: tuple[Request, ...] = ()
    """Those that were looked at last."""
    begun: Mapping[str, tuple[str, float]] = field(default_factory=dict)
    """Service that is coming up -> (start or resume, since when)."""
    warm: Mapping[str, Warm] = field(default_factory=dict)
    failed: Mapping[str, float] = field(default_factory=dict)
    """Service that ended while it was warm -> when that may be tried again."""

    @property
    def learned(self) -> Learned:
        return self.learning.learned if self.learning else Learned()


def noted(foresight: Foresight, actions: Sequence[Action], now: float) -> Foresight:
    """Actions are begun: what of them brings up a service is timed until that is ready."""
    coming = {a.service: (a.verb, now) for a in actions if a.operation.begins}
    if not coming or foresight.learning is None:
        return foresight
    return replace(foresight, begun={**foresight.begun, **coming})


def timed(learned: Learned, service: str, verb: str, seconds: float, declared: Collection[str]) -> Learned:
    """It took so long: the mean of this and of what it took before, so that a change shows soon. Services that are
    not declared any more are forgotten."""
    took = {name: known for name, known in learned.took.items() if name in declared}
    known = took.get(service, {})
    mean = (known[verb] + seconds) / 2 if verb in known else seconds
    return replace(learned, took={**took, service: {**known, verb: round(mean, 3)}})


def foresee(
    learning: Learning, catalog: Catalog, within: Mapping[str, float], now: float
) -> tuple[dict[str, Likelihood], float | None]:
    """Of the services in `within`, how likely it is that each is requested in so many seconds from now on: of the
    departures that took longer than the state of now has lasted, the part that leads to it in that time. One more is
    counted that does not, so that a few departures do not make a certainty. Of several requesters the likeliest
    counts. And when to look again: when the next departure comes into such a time, or has passed."""
    found, looks, asked = dict[str, Likelihood](), list[float](), dict[Names, frozenset[str]]()
    for requester, stay in learning.stays.items():
        departures = learning.learned.of(requester, stay.names)
        if stay.since is None or len(departures) < FEWEST:
            continue
        elapsed, hits, left = now - stay.since, dict[str, int](), 0
        for departure in departures:
            if departure.after <= elapsed:
                continue
            left += 1
            names = asked.get(departure.to)
            if names is None:
                names = asked[departure.to] = asked_for(catalog, departure.to) & within.keys()
            looks += [stay.since + departure.after] if names else []
            for name in names:
                if departure.after <= elapsed + within[name] + EXACT:
                    hits[name] = hits.get(name, 0) + 1
                else:
                    looks.append(stay.since + departure.after - within[name])
        for name, count in hits.items():
            probability = count / (left + 1)
            if name not in found or found[name].probability < probability:
                found[name] = Likelihood(requester, probability, within[name])
    return found, max(min(looks), now + LOOK) if looks else None


def asked_for(catalog: Catalog, names: Names) -> frozenset[str]:
    """Services that are wanted when these are requested."""
    return frozenset(closure(catalog.services, [m for name in names for m in catalog.members(name)]))
