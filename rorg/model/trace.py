"""Requests to a robot over some hours, frozen: the input of simulations, recorded or generated."""

from __future__ import annotations

from dataclasses import dataclass, replace


@dataclass(frozen=True, slots=True)
class TraceEvent:
    """A requester requests services, replacing its request with this id, or releases it."""

    at: float
    """Seconds since the trace began."""
    requester: str
    id: str
    """Id of the request. A behaviour has one request, with its own name."""
    services: tuple[str, ...] = ()
    """Services and groups; none for a release."""
    state: str = ""
    """The state that a behaviour enters; empty for other requests."""


@dataclass(frozen=True, slots=True)
class Trace:
    """Events in order of time. Nothing is requested at the start."""

    name: str
    duration: float
    """Seconds."""
    events: tuple[TraceEvent, ...]
    description: str = ""

    def states(self) -> list[tuple[float, float, str, str]]:
        """(from, to, behaviour, state) of all states, in order of time."""
        states, open_at = list[tuple[float, float, str, str]](), dict[str, tuple[float, str]]()
        for event in self.events:
            if event.requester in open_at:
                since, state = open_at.pop(event.requester)
                states.append((since, event.at, event.requester, state))
            if event.state:
                open_at[event.requester] = event.at, event.state
        states += [(since, self.duration, who, state) for who, (since, state) in open_at.items()]
        return sorted(states)

    def compressed(self, factor: float) -> Trace:
        """The same trace, `factor` times faster."""
        events = tuple(replace(event, at=event.at / factor) for event in self.events)
        return replace(self, duration=self.duration / factor, events=events)

    def delayed(self, seconds: float) -> Trace:
        """The same trace after a pause of so many seconds."""
        events = tuple(replace(event, at=event.at + seconds) for event in self.events)
        return replace(self, duration=self.duration + seconds, events=events)
