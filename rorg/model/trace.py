"""What a robot was asked for over some hours, frozen: the input of simulations, recorded or generated."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class TraceEvent:
    """A requester asks for services, in place of what it asked for by this id; or releases it."""

    at: float
    """Seconds since the trace began."""
    requester: str
    id: str
    """Of the request. A behaviour has one request, of its own name."""
    services: tuple[str, ...] = ()
    """Services and groups; none where the request is released."""
    state: str = ""
    """The state that a behaviour is in from now on; empty for a request by itself."""


@dataclass(frozen=True, slots=True)
class Trace:
    """Events in order of time. Nothing is requested when it begins."""

    name: str
    duration: float
    """Seconds."""
    events: tuple[TraceEvent, ...]
    description: str = ""

    def states(self) -> list[tuple[float, float, str, str]]:
        """(from, to, behaviour, state), in order of time: what the robot is doing."""
        found, open_at = list[tuple[float, float, str, str]](), dict[str, tuple[float, str]]()
        for event in self.events:
            if event.requester in open_at:
                since, state = open_at.pop(event.requester)
                found.append((since, event.at, event.requester, state))
            if event.state:
                open_at[event.requester] = event.at, event.state
        found += [(since, self.duration, who, state) for who, (since, state) in open_at.items()]
        return sorted(found)

    def compressed(self, factor: float) -> Trace:
        """The same in a `factor`th of the time."""
        events = tuple(replace(event, at=event.at / factor) for event in self.events)
        return replace(self, duration=self.duration / factor, events=events)

    def delayed(self, seconds: float) -> Trace:
        """The same after so many seconds in which nothing happens."""
        events = tuple(replace(event, at=event.at + seconds) for event in self.events)
        return replace(self, duration=self.duration + seconds, events=events)
