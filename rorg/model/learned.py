"""What rorg learned about requests, frozen: what follows what, and after how long."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Names = tuple[str, ...]
"""Everything a requester requests at one time: names of services and groups as written, sorted."""


@dataclass(frozen=True, slots=True)
class Departure:
    """One change of what a requester requests."""

    after: float
    """Seconds for which it had requested the previous names."""
    to: Names
    """The names it requested next; empty for nothing."""


@dataclass(frozen=True, slots=True)
class Learned:
    """A Markov chain per requester, whose states are what it requests. Probabilities and times come from the last
    departures from each state; core/prediction.py limits their number."""

    departures: Mapping[str, Mapping[Names, tuple[Departure, ...]]] = field(default_factory=dict)
    """Requester -> requested names -> departures, the latest last."""
    took: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Service -> verb (start or resume) -> recent seconds from the call until ready."""

    def of(self, requester: str, names: Names) -> tuple[Departure, ...]:
        return self.departures.get(requester, {}).get(names, ())

    @property
    def names(self) -> set[str]:
        """All names that were ever requested."""
        states = (state for known in self.departures.values() for state in known.items())
        return {name for asked, ways in states for names in (asked, *(way.to for way in ways)) for name in names}


@dataclass(frozen=True, slots=True)
class Likelihood:
    """The likelihood that a service will be requested soon."""

    requester: str
    probability: float
    within: float
    """Seconds."""

    def __str__(self) -> str:
        return f"{self.requester} asks for it within {self.within:.1f} s in {self.probability:.0%} of cases"
