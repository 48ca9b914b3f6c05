"""What was learnt of requests, frozen: what is requested after what, and how long it takes until then."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Names = tuple[str, ...]
"""What a requester asks for, all its requests together: names of services and groups as they are written, sorted."""


@dataclass(frozen=True, slots=True)
class Departure:
    """How a requester went on from what it asked for."""

    after: float
    """Seconds for which it had asked for that."""
    to: Names
    """What it asked for then; empty for nothing."""


@dataclass(frozen=True, slots=True)
class Learned:
    """A Markov chain for each requester, whose states are what it asks for. The probabilities and the times are those
    of the last departures from each, which are bounded in number (see core/learning.py)."""

    departures: Mapping[str, Mapping[Names, tuple[Departure, ...]]] = field(default_factory=dict)
    """Requester -> what it asked for -> how that went on, the latest last."""
    took: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Service -> verb (start or resume) -> seconds that it took lately, from the call until it was ready."""

    def of(self, requester: str, names: Names) -> tuple[Departure, ...]:
        return self.departures.get(requester, {}).get(names, ())

    @property
    def names(self) -> set[str]:
        """All that was ever asked for."""
        states = (state for known in self.departures.values() for state in known.items())
        return {name for asked, ways in states for names in (asked, *(way.to for way in ways)) for name in names}


@dataclass(frozen=True, slots=True)
class Likelihood:
    """That a service will be requested soon."""

    requester: str
    probability: float
    within: float
    """Seconds."""

    def __str__(self) -> str:
        return f"{self.requester} asks for it within {self.within:.1f} s in {self.probability:.0%} of cases"
