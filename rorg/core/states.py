"""What services go through, as the journal has it: states that their containers are seen in, with why and for whom."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from rorg.core.decide import Decision
from rorg.core.wanted import chain

NONE, READY = "none", "ready"
"""No container; running and ready. All else is the engine's word."""


@dataclass(frozen=True, slots=True)
class Passage:
    """A service has come into another state."""

    service: str
    state: str
    reason: str
    """Why it is wanted, or how its run ended, or what keeps it out."""
    requests: tuple[str, ...] = ()
    """REQUESTER/ID of those that lead to it, from the root on."""

    def __str__(self) -> str:
        said = "has no container" if self.state == NONE else f"is {self.state}"
        return f"{self.service} {said}" + (f" ({self.reason})" if self.reason else "")


def state_of(decision: Decision, name: str) -> str:
    """The state of a service; of several containers that of the one by which it is active."""
    containers = decision.situation.observed.by_service().get(name)
    if not containers:
        return NONE
    return READY if containers[0].active and decision.memory.of(name).ready else containers[0].state


def passages(before: Mapping[str, str], decision: Decision) -> list[Passage]:
    """Of the services that a pass has looked at, those that it found in another state than the one `before`."""
    services = decision.situation.desired.catalog.services
    names = {*services, *before} if decision.whole else decision.looked_at
    return [
        _passage(decision, name, now)
        for name in sorted(names)
        if (now := state_of(decision, name)) != before.get(name, NONE)
    ]


def _passage(decision: Decision, name: str, now: str) -> Passage:
    situation, step = decision.situation, decision.memory.of(name)
    causes = situation.wanted.get(name, ())
    current = next(iter(situation.observed.by_service().get(name, ())), None)
    if causes and now == "exited" and current and step.exited == current.incarnation:
        return Passage(name, now, step.error)
    trail = [cause for _, cause in chain(situation.wanted, name)]
    asked = tuple(f"{cause.by}/{cause.request}" for cause in trail if cause.kind == "requested")
    if causes:
        return Passage(name, now, str(causes[0]), asked)
    return Passage(name, now, decision.holds.get(name) or situation.preempted.get(name) or "not wanted")
