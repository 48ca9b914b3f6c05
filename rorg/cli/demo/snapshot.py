"""Snapshots of the robot: which services run and why, and what changed between two of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

State = Literal["running", "paused", "stopped"]


@dataclass(frozen=True, slots=True)
class Service:
    """One service. `run` is the incarnation of its container, which every start changes."""

    state: State
    why: str
    run: str


class Change(NamedTuple):
    """What happened to a service between two snapshots."""

    verb: str
    service: str
    why: str


@dataclass(frozen=True, slots=True)
class Snapshot:
    """All services at one moment, without meta-services, which have no container."""

    services: Mapping[str, Service] = field(default_factory=dict)

    @classmethod
    def of(cls, status: Mapping[str, Any]) -> Snapshot:
        """Read the status that a running rorg answers or publishes."""
        found = ((name, s) for name, s in status["services"].items() if s["state"] != "meta")
        return cls({name: Service(_state(s["state"]), s["why"], s["incarnation"]) for name, s in found})

    def names(self, state: State) -> set[str]:
        return {name for name, service in self.services.items() if service.state == state}

    def counts(self) -> str:
        """Format the number of services in each state."""
        count = Counter(service.state for service in self.services.values())
        return f"{count['running']} services run, {count['paused']} paused, {count['stopped']} stopped"

    def runs(self) -> dict[str, str]:
        """Service -> the run that it is in now."""
        return {name: service.run for name, service in self.services.items() if service.state == "running"}

    def changes(self, before: Snapshot) -> Iterator[Change]:
        """Yield the services whose state changed."""
        for name, service in sorted(self.services.items()):
            earlier = before.services.get(name, Service("stopped", "", ""))
            if service.state == earlier.state:
                continue
            if service.state == "running":
                yield Change("resumed" if earlier.state == "paused" else "started", name, service.why)
            else:
                yield Change(service.state, name, service.why)


def _state(engine_word: str) -> State:
    if engine_word == "running":
        return "running"
    return "paused" if engine_word == "paused" else "stopped"
