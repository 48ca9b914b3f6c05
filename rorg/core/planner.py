"""The one planner: make_plan(situation) -> Plan. Pure.

For each service it writes down the whole chain of engine calls that leads from what is observed to what is desired;
then it lets through what may happen, links what must wait for other actions of the plan, and turns the rest into
waitings with a reason.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from rorg.core.desired import Situation
from rorg.core.diff import Difference, difference
from rorg.core.digest import labels
from rorg.core.observed import Container
from rorg.core.plan import Action, Plan, Waiting
from rorg.manifest.catalog import Service
from rorg.manifest.scalars import format_seconds

STOP_GRACE = 5.0
"""Seconds between the stop signal and SIGTERM, where stop_grace_period is not declared."""


@dataclass(frozen=True, slots=True)
class Step:
    """One link of a service's chain, not yet let through."""

    verb: str
    container: Container | None
    reason: str
    fields: tuple[str, ...] = ()
    args: Mapping[str, Any] = field(default_factory=dict)
    part_of: str = ""


def make_plan(situation: Situation) -> Plan:
    """What to do, in order: first what must be ceased, dependants first; then what must run, needs first."""
    if not situation.observed.complete:
        return Plan(waitings=(Waiting("engine", situation.observed.error or "the engine has not answered yet"),))
    return _Planner(situation).plan()


class _Planner:
    def __init__(self, situation: Situation) -> None:
        self.s = situation
        self.desired = situation.desired
        self.services = situation.desired.catalog.services
        self.containers = situation.observed.by_service()
        self.actions: list[Action] = []
        self.waitings: list[Waiting] = []
        self.last: dict[str, int] = {}
        """Index of the last action of a service's chain."""
        self.blocked: dict[str, str] = {}
        """Why a service's chain stops short, for those who wait for it."""

    def plan(self) -> Plan:
        for name in sorted(set(self.containers) - {n for n, s in self.services.items() if not s.meta}):
            self.undeclared(name)
        for name in reversed(self.desired.order):
            if name not in self.s.wanted:
                self.let_through(self.services[name])
        for name in self.desired.order:
            if name in self.s.wanted and not self.services[name].meta:
                self.let_through(self.services[name])
        self.waitings += [Waiting(name, reason) for name, reason in self.s.gave_way.items()]
        return Plan(tuple(self.actions), tuple(self.waitings))

    # -- chains ------------------------------------------------------------------------------------------------

    def undeclared(self, name: str) -> None:
        """A service of ours that no manifest declares any more."""
        if name in self.s.memory.in_flight:
            return
        if not self.s.removals:
            self.waitings.append(Waiting(name, "not declared; its removal is withheld until the manifests load"))
            return
        steps = [s for c in self.containers[name] for s in _away(c, "no manifest declares it")]
        self.emit(Service(name), steps)

    def chain(self, service: Service) -> list[Step]:
        """All steps of a service, from what is observed to what is desired."""
        name, spec = service.name, service.spec or {}
        is_wanted = name in self.s.wanted
        keep = is_wanted or service.idle.action != "remove"
        pairs = [(c, difference(c, spec, self.desired.digests[name])) for c in self.containers.get(name, [])]
        current = next(((c, d) for c, d in pairs if not d.recreate), None) if keep else None
        stale = [(c, d) for c, d in pairs if current is None or c is not current[0]]
        steps: list[Step] = []
        new_name = ""
        if keep and current is None:
            new_name = self.free_name(service, [c for c, _ in stale])
            steps.append(self.create(service, new_name, stale))
        steps += self.clear(service, stale, keep)
        if current:
            steps += self.adjust(service, *current)
        elif keep and new_name != service.container_name:
            steps.append(Step("rename", None, "it takes its name", args={"name": service.container_name}))
        if is_wanted:
            steps += self.wake(service, current[0] if current else None, steps)
        elif current:
            steps += self.cease(service, current[0])
        if any(diff.recreate for _, diff in stale) and keep:
            steps = [replace(s, part_of="replace") for s in steps]
        return steps

    def free_name(self, service: Service, stale: list[Container]) -> str:
        """The service's name, or one made of the digest while an older container of the service still has it."""
        if any(c.name == service.container_name for c in stale):
            return f"{service.container_name}.{self.desired.digests[service.name].partition(':')[2][:8]}"
        return service.container_name

    def create(self, service: Service, name: str, stale: list[tuple[Container, Difference]]) -> Step:
        spec = service.spec or {}
        fields = tuple(sorted({f for _, d in stale for f in d.recreate}))
        return Step("create", None, "changed" if stale else "no container", fields, {
            "name": name, "spec": spec, "labels": labels(self.s.owner, service.name, spec),
            "digest": self.desired.digests[service.name],
        })

    def clear(self, service: Service, stale: list[tuple[Container, Difference]], keep: bool) -> list[Step]:
        """The way out for containers that are not (or no longer) the service's one."""
        steps: list[Step] = []
        for container, diff in stale:
            reason = "changed" if diff.recreate else "a second container of this service"
            steps += _away(container, reason if keep else "not wanted", service)
        return steps

    def adjust(self, service: Service, container: Container, diff: Difference) -> list[Step]:
        """Name and live options of the container that stays."""
        steps = []
        if diff.live:
            steps.append(Step("update", container, "changed", tuple(sorted(diff.live)), {"options": diff.live}))
        if container.name != service.container_name:
            steps.append(Step("rename", container, f"it is called {container.name}",
                              args={"name": service.container_name}))
        asked = self.s.restarts.get(service.name, "")
        if container.alive and container.started_at < asked and service.name in self.s.wanted:
            steps.append(_stop(container, "restart asked for", service))
        return steps

    def wake(self, service: Service, container: Container | None, steps: list[Step]) -> list[Step]:
        why = str(self.s.wanted[service.name][0])
        if container is None or any(s.verb == "stop" and s.container is container for s in steps):
            return [Step("start", container, why)]
        if container.state == "paused":
            return [Step("resume", container, why)]
        if container.state in ("running", "restarting", "removing"):
            return []
        if container.state == "dead":
            return [Step("remove", container, "the engine calls it dead")]
        step = self.s.memory.of(service.name)
        if step.over(service, container):
            return []
        if container.state == "exited" and step.exited == container.incarnation:
            why += f"; {step.error}"
        return [Step("start", container, why)]

    def completed(self, need: str) -> bool:
        """It did what it was for, and ended well."""
        current = next(iter(self.containers.get(need, [])), None)
        return current is not None and current.exit_code == 0 and self.s.memory.of(need).over(
            self.services[need], current)

    def cease(self, service: Service, container: Container) -> list[Step]:
        """A service that nobody wants: as its idle policy says. (Removal is chain()'s: nothing is kept then.)"""
        if container.active and service.idle.action == "pause":
            return [Step("pause", container, "not wanted")]
        if container.alive and service.idle.action == "stop":
            return [_stop(container, "not wanted", service)]
        return []

    # -- what may happen now -----------------------------------------------------------------------------------

    def let_through(self, service: Service) -> None:
        name = service.name
        if service.meta:
            return
        flight = self.s.memory.in_flight.get(name)
        if flight:
            self.blocked[name] = f"{flight.action.verb} under way for {format_seconds(self.s.now - flight.since)}"
            return
        self.emit(service, self.chain(service))

    def emit(self, service: Service, steps: list[Step]) -> None:
        """Appends a chain's steps up to the first one that must wait."""
        name = service.name
        for step in steps:
            after = () if name not in self.last else (self.last[name],)
            linked, waiting = self.gate(service, step)
            if waiting:
                self.waitings.append(waiting)
                self.blocked[name] = waiting.reason
                return
            self.last[name] = len(self.actions)
            self.actions.append(Action(
                index=len(self.actions), verb=step.verb, service=name,
                container=step.container.id if step.container else "", reason=step.reason, fields=step.fields,
                after=tuple(dict.fromkeys(after + linked)), args=step.args, urgent=self.is_urgent(name, step),
                priority=service.priority, part_of=step.part_of,
            ))

    def is_urgent(self, name: str, step: Step) -> bool:
        """What brings up a service that a live request waits for; not what replaces one that runs."""
        if name not in self.s.urgent:
            return False
        return step.verb in ("create", "rename", "start", "resume") and not any(
            c.active for c in self.containers.get(name, []))

    def gate(self, service: Service, step: Step) -> tuple[tuple[int, ...], Waiting | None]:
        """Actions that this step must follow, or what it waits for."""
        memory = self.s.memory.of(service.name)
        asked = self.s.restarts.get(service.name, "")
        impatient = step.verb == "start" and step.container is not None and step.container.started_at < asked
        if memory.retry_verb == step.verb and memory.retry_at > self.s.now and not impatient:
            wait = format_seconds(memory.retry_at - self.s.now)
            word = "stalled" if memory.stalled else "failed"
            return (), Waiting(service.name, f"{step.verb} {word}: {memory.error or 'no effect'}; again in {wait}",
                               memory.retry_at)
        if step.verb in ("start", "resume"):
            return self.gate_start(service)
        if step.verb in ("pause", "stop", "remove") and service.name not in self.s.wanted:
            return self.gate_cease(service)
        return (), None

    def gate_start(self, service: Service) -> tuple[tuple[int, ...], Waiting | None]:
        after: list[int] = []
        for need in service.needs:
            if need in self.last:
                after.append(self.last[need])
            reason = self.unready(need)
            if reason:
                return (), Waiting(service.name, f"{need} {reason}", self.deadline(need))
        for other in self.desired.conflicts.get(service.name, ()):
            if any(c.active for c in self.containers.get(other, [])):
                if other not in self.last:
                    return (), Waiting(service.name, f"conflicts with {other}, which is active")
                after.append(self.last[other])
        return tuple(after), None

    def unready(self, need: str) -> str:
        """Why a needed service is not ready and nothing in this plan will make it so; empty otherwise."""
        if need not in self.services or self.services[need].meta:
            return "" if need in self.services else "is not declared"
        if need in self.blocked:
            return f"waits: {self.blocked[need]}"
        if need in self.last:
            return ""
        step, ready = self.s.memory.of(need), self.services[need].ready
        if step.ready or self.completed(need):
            return ""
        if step.running_since is None:
            return f"is not running ({step.error or 'ended'})"
        seconds = None if ready is None else float(ready.target) if ready.probe == "delay" else ready.timeout
        limit = "" if seconds is None else f" of {format_seconds(seconds)}"
        detail = f": {step.probe}" if step.probe else ""
        return f"is not ready ({format_seconds(self.s.now - step.running_since)}{limit}){detail}"

    def deadline(self, need: str) -> float | None:
        """When a needed service becomes ready by the clock alone."""
        step, ready = self.s.memory.of(need), self.services[need].ready if need in self.services else None
        if ready and ready.probe == "delay" and step.running_since is not None:
            return step.running_since + float(ready.target)
        return None

    def gate_cease(self, service: Service) -> tuple[tuple[int, ...], Waiting | None]:
        active = any(c.active for c in self.containers.get(service.name, []))
        if not active or service.name not in self.services:
            return (), None
        after = []
        for dependant in self.desired.dependants.get(service.name, ()):
            if any(c.active for c in self.containers.get(dependant, [])):
                if dependant not in self.last:
                    return (), Waiting(service.name, f"not wanted, but {dependant} needs it and is still active")
                after.append(self.last[dependant])
        since = self.s.memory.of(service.name).unwanted_since
        rivals = [o for o in self.desired.conflicts.get(service.name, ()) if o in self.s.wanted]
        until = (self.s.now if since is None else since) + (0.0 if rivals else service.idle.linger)
        if until > self.s.now:
            return (), Waiting(service.name, f"not wanted; lingers for {format_seconds(until - self.s.now)}", until)
        return tuple(after), None


def _away(container: Container, reason: str, service: Service | None = None) -> list[Step]:
    """Stop if it is alive, then remove."""
    steps = [_stop(container, reason, service)] if container.alive else []
    return [*steps, Step("remove", container, reason)]


def _stop(container: Container, reason: str, service: Service | None) -> Step:
    spec = (service.spec if service else None) or {}
    return Step("stop", container, reason, args={
        "signal": spec.get("stop_signal", "SIGTERM"),
        "grace": spec.get("stop_grace_period", STOP_GRACE),
        "incarnation": container.incarnation,
    })
