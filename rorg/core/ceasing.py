"""What becomes of a service that nobody wants: as its idle policy says. (Removal is that of reconcile.py: nothing is
kept then.)"""

from __future__ import annotations

from rorg.core.memory import Attempt
from rorg.core.observed import Container
from rorg.core.operations import Pause
from rorg.core.pausing import in_use
from rorg.core.steps import Step, away, stop
from rorg.core.view import View
from rorg.model.catalog import Service
from rorg.model.units import format_seconds

PAUSES = 2
"""Failed attempts to pause after which a service is stopped."""
Ceasing = tuple[list[Step], float | None]
"""Steps, and the time at which more is to be done though nobody waits for it."""


def cease(view: View, service: Service, container: Container) -> Ceasing:
    """What is to be done of its container now."""
    situation, idle = view.s, service.idle
    why, since = situation.preempted.get(service.name, "not wanted"), situation.memory.of(service.name).ceased_since
    frees = service.name in situation.shed or (container.alive and view.exclusive.contested(service))
    if container.active and idle.action == "pause" and not frees:
        return [_pause(view, service, container, why)], None
    if container.alive and (idle.action == "stop" or frees):
        return [stop(container, why, service)], None
    if container.state == "paused" and (why := _not_paused_any_more(view, service)):
        return [stop(container, why, service)], None
    if idle.escalate and since is not None:
        return _escalate(view, service, container, since, *idle.escalate)
    return [], None


def _pause(view: View, service: Service, container: Container, why: str) -> Step:
    """Pause, or stop if the engine cannot pause or the pause would affect others: no idle service runs for ever."""
    if not view.s.engine.pause:
        return stop(container, f"{why}; stop instead of pause: the engine cannot pause", service)
    tried = view.s.memory.of(service.name).attempt(Pause) or Attempt()
    if tried.error and (tried.unsupported or tried.count >= PAUSES):
        return stop(container, f"{why}; stop instead of pause: {tried.error}", service)
    use = in_use(view.s, service) if service.idle.connected == "stop" else None
    if use is None:
        return Step(Pause(container=container.id), why)
    return stop(container, f"{why}; stop instead of pause: {use}", service)


def _not_paused_any_more(view: View, service: Service) -> str:
    """Why one that is paused is to be stopped; empty where it sleeps on."""
    if view.s.stop_paused:
        return "the machine is short of memory"
    use = in_use(view.s, service) if service.idle.connected == "stop" else None
    # What is not known may be as it was when it was paused.
    return f"stop instead of pause: {use}" if use and use.connections else ""


def _escalate(view: View, service: Service, container: Container, since: float, after: float, action: str) -> Ceasing:
    """The second, harder step for what stays unwanted."""
    if action == "stop" and not container.alive:
        return [], None
    if since + after > view.now:
        return [], since + after if container.state == "paused" or action == "remove" else None
    why = f"not wanted for {format_seconds(view.now - since)}"
    if action == "remove":
        return away(container, why, service, volumes=True), None
    return [stop(container, why, service)], None
