"""What happens to a service that nothing wants, as its idle policy says: pause, stop or remove. The paper's robot
pauses or stops what is not requested (section III-C).

Removal (`action: remove`) is in reconcile.py, because then no container is kept.
"""

from __future__ import annotations

from rorg.core.memory import Attempt
from rorg.core.observed import Container
from rorg.core.operations import Pause
from rorg.core.pausing import in_use
from rorg.core.situation import View
from rorg.core.steps import Step, away, stop
from rorg.model.catalog import Service
from rorg.model.units import format_seconds

PAUSES = 2
"""Failed attempts to pause after which a service is stopped instead: pausing can fail under load ("unable to
freeze")."""
Ceasing = tuple[list[Step], float | None]
"""Steps, and the time at which the next step is due although nothing waits for it."""


def cease(view: View, service: Service, container: Container) -> Ceasing:
    """Return what to do now with the container of an unwanted service."""
    situation, idle = view.s, service.idle
    why, since = situation.preempted.get(service.name, "not wanted"), situation.memory.of(service.name).ceased_since
    frees = service.name in situation.shed or (container.alive and view.exclusive.contested(service))
    if container.active and idle.action == "pause" and not frees:
        return [_pause(view, service, container, why)], None
    if container.alive and (idle.action == "stop" or frees):
        return [stop(container, why, service)], None
    if container.state == "paused" and (why := _why_stop_paused(view, service)):
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


def _why_stop_paused(view: View, service: Service) -> str:
    """Return why a paused service must be stopped; "" if it stays paused."""
    if view.s.stop_paused:
        return "the machine is short of memory"
    use = in_use(view.s, service) if service.idle.connected == "stop" else None
    # Unknown connections may be the same as when it was paused: leave it paused.
    return f"stop instead of pause: {use}" if use and use.connections else ""


def _escalate(view: View, service: Service, container: Container, since: float, after: float, action: str) -> Ceasing:
    """Take the second, harder step for a service that stays unwanted."""
    if action == "stop" and not container.alive:
        return [], None
    if since + after > view.now:
        return [], since + after if container.state == "paused" or action == "remove" else None
    why = f"not wanted for {format_seconds(view.now - since)}"
    if action == "remove":
        return away(container, why, service, volumes=True), None
    return [stop(container, why, service)], None
