"""State changes of services for the journal: the new state, the reason, and the requests behind it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from rorg.core.decide import Decision
from rorg.core.wanted import chain

NONE, READY = "none", "ready"
"""No container; running and ready. Every other state is the engine's word."""


@dataclass(frozen=True, slots=True)
class StateChange:
    """A service has entered another state."""

    service: str
    state: str
    reason: str
    """Why it is wanted, how its run ended, or what prevents it."""
    requests: tuple[str, ...] = ()
    """REQUESTER/ID of the requests that lead to it, from the root on."""

    def __str__(self) -> str:
        said = "has no container" if self.state == NONE else f"is {self.state}"
        return f"{self.service} {said}" + (f" ({self.reason})" if self.reason else "")


def state_of(decision: Decision, name: str) -> str:
    """Return the state of a service's current container."""
    containers = decision.situation.observed.by_service().get(name)
    if not containers:
        return NONE
    return READY if containers[0].active and decision.memory.of(name).ready else containers[0].state


def state_changes(before: Mapping[str, str], decision: Decision) -> list[StateChange]:
    """Return state changes among services that were planned in this pass."""
    services = decision.situation.desired.catalog.services
    names = {*services, *before} if decision.whole else decision.replanned
    return [
        _state_change(decision, name, now)
        for name in sorted(names)
        if (now := state_of(decision, name)) != before.get(name, NONE)
    ]


def _state_change(decision: Decision, name: str, now: str) -> StateChange:
    situation, progress = decision.situation, decision.memory.of(name)
    causes = situation.wanted.get(name, ())
    current = situation.observed.current(name)
    if causes and now == "exited" and current and progress.exited == current.incarnation:
        return StateChange(name, now, progress.error)
    trail = [cause for _, cause in chain(situation.wanted, name)]
    requests = tuple(f"{cause.by}/{cause.request}" for cause in trail if cause.kind == "requested")
    if causes:
        return StateChange(name, now, str(causes[0]), requests)
    return StateChange(name, now, decision.holds.get(name) or situation.preempted.get(name) or "not wanted")
