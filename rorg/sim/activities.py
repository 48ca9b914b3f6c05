"""What fills the time of a trace: how often and how long a robot is in each state, and holds each request."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from rorg.model.trace import Trace


@dataclass(frozen=True, slots=True)
class Activity:
    """A state of a behaviour, or a request by itself, over a whole trace."""

    kind: str
    """state or request."""
    by: str
    """The behaviour, or the requester."""
    name: str
    """Of the state; or the request's id."""
    lengths: tuple[float, ...]
    """Seconds of each time, in order. A request that is made anew with other services is another time."""

    @property
    def total(self) -> float:
        return sum(self.lengths)

    @property
    def mean(self) -> float:
        return self.total / len(self.lengths)

    def as_json(self) -> dict[str, Any]:
        return {
            "kind": self.kind,
            "by": self.by,
            "name": self.name,
            "times": len(self.lengths),
            "total": round(self.total, 3),
            "mean": round(self.mean, 3),
            "min": round(min(self.lengths), 3),
            "max": round(max(self.lengths), 3),
        }


def activities(trace: Trace) -> list[Activity]:
    """All of a trace, in the order in which they come first."""
    lengths = dict[tuple[str, str, str], list[float]]()
    under_way = dict[tuple[str, str], tuple[float, list[float]]]()
    for event in trace.events:
        request = event.requester, event.id
        if request in under_way:
            since, of = under_way.pop(request)
            of.append(event.at - since)
        if event.state or event.services:
            what = ("state", event.requester, event.state) if event.state else ("request", *request)
            under_way[request] = event.at, lengths.setdefault(what, [])
    for since, of in under_way.values():
        of.append(trace.duration - since)
    return [Activity(*what, tuple(of)) for what, of in lengths.items()]
