"""What leads each service from what is observed to what is desired: chains of engine calls, not yet let through."""

from __future__ import annotations

from collections.abc import Container as Names
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from rorg.core.desired import Situation
from rorg.core.diff import Difference, difference
from rorg.core.digest import Rules, declared_of, labels, rules_of
from rorg.core.memory import DEFAULT_GRACE
from rorg.core.observed import Container
from rorg.core.pressure import LOWERED_SHARES
from rorg.manifest.catalog import Service
from rorg.manifest.scalars import format_seconds

DEFAULT_SHARES = 1024
"""What an engine gives a container that declares no cpu_shares."""


@dataclass(frozen=True, slots=True)
class Step:
    """One link of a service's chain, not yet let through."""

    verb: str
    container: Container | None
    reason: str
    fields: tuple[str, ...] = ()
    args: Mapping[str, Any] = field(default_factory=dict)
    part_of: str = ""


class Chains:
    """Of one situation. `moving` are the services that the plan already has actions for."""

    def __init__(self, situation: Situation, containers: Mapping[str, list[Container]], moving: Names[str]) -> None:
        self.s, self.desired, self.containers, self.moving = situation, situation.desired, containers, moving
        self.alarms: list[float] = []
        """Times at which something will be done that is no waiting of anybody's."""
        services = situation.desired.catalog.services
        self.undeclared = {n: cs for n, cs in containers.items() if n not in services or services[n].meta}
        """Containers of services that no manifest declares, or not as having one."""

    def of(self, service: Service) -> list[Step]:
        """All steps of a service, from what is observed to what is desired."""
        name, spec = service.name, service.spec or {}
        is_wanted = name in self.s.wanted
        pairs = [(c, difference(c, spec, self.desired.digests[name], self.desired.declared[name]))
                 for c in self.containers.get(name, [])]
        current = next(((c, d) for c, d in pairs if not d.recreate), None)
        keep = is_wanted or self.keeps(service, current is not None)
        current = current if keep else None
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
            return [replace(s, part_of="replace") for s in steps]
        if current and is_wanted and any(s.verb == "stop" and s.container is current[0] for s in steps):
            return [replace(s, part_of="restart") if s.verb in ("stop", "start") else s for s in steps]
        return steps

    @staticmethod
    def keeps(service: Service, has_one: bool) -> bool:
        """Whether it has a container while nobody wants it. One that was removed at the end of its idling is not made
        again."""
        ends_removed = service.idle.escalate is not None and service.idle.escalate[1] == "remove"
        return service.idle.action != "remove" and (has_one or not ends_removed)

    def free_name(self, service: Service, stale: list[Container]) -> str:
        """The service's name, or one made of the digest while an older container of the service still has it."""
        if any(c.name == service.container_name for c in stale):
            return self.passing_name(service)
        return service.container_name

    def create(self, service: Service, name: str, stale: list[tuple[Container, Difference]]) -> Step:
        spec = service.spec or {}
        fields = tuple(sorted({f for _, d in stale for f in d.recreate}))
        return Step("create", None, "changed" if stale else "no container", fields, {
            "name": name, "spec": spec, "labels": labels(self.s.owner, service.name, spec, self.rules(service)),
            "digest": self.desired.digests[service.name],
        })

    def rules(self, service: Service) -> Rules:
        return Rules(service.interlock, service.exclusive, self.desired.conflicts[service.name])

    def clear(self, service: Service, stale: list[tuple[Container, Difference]], keep: bool) -> list[Step]:
        """The way out for containers that are not (or no longer) the service's one."""
        steps: list[Step] = []
        for container, diff in stale:
            reason = "changed" if diff.recreate else "a second container of this service"
            steps += away(container, reason if keep else "not wanted", service)
        return steps

    def adjust(self, service: Service, container: Container, diff: Difference) -> list[Step]:
        """Name and live options of the container that stays."""
        steps = []
        shares = self.shares(service, container)
        live = {k: v for k, v in diff.live.items() if k != "cpu_shares" or service.name not in self.s.lowered}
        if live:
            steps.append(Step("update", container, "changed", tuple(sorted(live)), {"options": live}))
        elif shares is not None:
            why = "leaves the CPU to others" if shares == LOWERED_SHARES else "pressure is over"
            steps.append(Step("update", container, why, ("cpu_shares",), {"options": {"cpu_shares": shares}}))
        if container.name != service.container_name and container.name != (name := self.next_name(service)):
            steps.append(Step("rename", container, f"it is called {container.name}", args={"name": name}))
        why = self.restart(service, container)
        if why:
            steps.append(stop(container, why, service))
        return steps

    def next_name(self, service: Service) -> str:
        """The name to take now: the service's own, or a passing one while another service's container has that, which
        may be waiting for the name of this one."""
        taken = any(c.name == service.container_name and c.service != service.name
                    for c in self.s.observed.containers)
        return self.passing_name(service) if taken else service.container_name

    def passing_name(self, service: Service) -> str:
        return f"{service.container_name}.{self.desired.digests[service.name].partition(':')[2][:8]}"

    def shares(self, service: Service, container: Container) -> int | None:
        """CPU shares to set because of pressure, or to put back after it; None for as they are."""
        now = container.live.get("cpu_shares")
        if service.name in self.s.lowered:
            return LOWERED_SHARES if container.active and now != LOWERED_SHARES else None
        declared = (service.spec or {}).get("cpu_shares", DEFAULT_SHARES)
        return declared if now == LOWERED_SHARES != declared else None

    def restart(self, service: Service, container: Container) -> str:
        """Why the run of now must end though the service is wanted; empty when it may go on."""
        if not container.alive or service.name not in self.s.wanted:
            return ""
        if self.s.restarts.get(service.name) == container.incarnation:
            return "restart asked for"
        memory = self.s.memory.of(service.name)
        if memory.hung == container.incarnation:
            return memory.error
        for need in service.follows:
            current = next(iter(self.containers.get(need, [])), None)
            # Its readiness is waited for, since what ends now still wants to say goodbye to it.
            if current and current.state == "running" and memory.followed.lost(need, container, current) \
                    and need not in self.moving and self.s.memory.of(need).ready:
                return f"{need} was restarted"
        return ""

    def wake(self, service: Service, container: Container | None, steps: list[Step]) -> list[Step]:
        why = str(self.s.wanted[service.name][0])
        runs = {n: cs[0].incarnation for n in service.follows if (cs := self.containers.get(n)) and cs[0].started_at}
        start = {"follows": runs} if runs else {}
        if container is None or any(s.verb == "stop" and s.container is container for s in steps):
            return [Step("start", container, why, args=start)]
        if container.state == "paused":
            return [Step("resume", container, why)]
        if container.active:
            return []
        if container.state == "dead":
            return [Step("remove", container, "the engine calls it dead")]
        step = self.s.memory.of(service.name)
        if step.over(service, container) and self.s.restarts.get(service.name) != container.incarnation:
            return []
        if container.state == "exited" and step.exited == container.incarnation:
            why += f"; {step.error}"
        return [Step("start", container, why, args=start)]

    def cease(self, service: Service, container: Container) -> list[Step]:
        """A service that nobody wants: as its idle policy says. (Removal is chain()'s: nothing is kept then.)"""
        why = self.s.gave_way.get(service.name, "not wanted")
        action, since = service.idle.action, self.s.memory.of(service.name).ceased_since
        if container.active and action == "pause" and not self.contested(service) and service.name not in self.s.shed:
            return [Step("pause", container, why)]
        if container.alive and (action == "stop" or self.contested(service) or service.name in self.s.shed):
            return [stop(container, why, service)]
        if container.state == "paused" and self.s.stop_paused:
            return [stop(container, "the machine is short of memory", service)]
        if service.idle.escalate and since is not None:
            return self.escalate(service, container, since, *service.idle.escalate)
        return []

    def escalate(self, service: Service, container: Container, since: float, after: float, action: str) -> list[Step]:
        """The second, harder step for what stays unwanted."""
        if since + after > self.s.now:
            if container.state == "paused" or action == "remove":
                self.alarms.append(since + after)
            return []
        why = f"not wanted for {format_seconds(self.s.now - since)}"
        if action == "remove":
            return away(container, why, service)
        return [stop(container, why, service)] if container.alive else []

    def contested(self, service: Service) -> bool:
        """It holds an exclusive resource, even when paused, that a wanted service waits for."""
        for resource, units in service.exclusive.items():
            sharers = [o for o in self.desired.sharers[resource] if o != service.name]
            used = units + sum(self.units(o, resource) for o in sharers if self.alive(o))
            used += sum(self.left_over(resource).values())
            there = self.desired.catalog.policy.resources.get(resource, 1)
            if any(used + (0 if self.alive(o) else self.units(o, resource)) > there for o in sharers
                   if o in self.s.wanted and not self.done(o)):
                return True
        return False

    def left_over(self, resource: str) -> dict[str, int]:
        """Services that no manifest declares any more, and still hold units of an exclusive resource."""
        return {name: units for name, cs in self.undeclared.items()
                if self.alive(name) and (units := rules_of(cs[0].rules).exclusive.get(resource, 0))}

    def units(self, name: str, resource: str) -> int:
        return self.desired.catalog.services[name].exclusive[resource]

    def alive(self, name: str) -> bool:
        return any(c.alive for c in self.containers.get(name, []))

    def done(self, name: str) -> bool:
        """It ended, and its restart policy leaves it at that."""
        current = next(iter(self.containers.get(name, [])), None)
        service = self.desired.catalog.services[name]
        return current is not None and self.s.memory.of(name).over(service, current)


def away(container: Container, reason: str, service: Service | None = None) -> list[Step]:
    """Stop if it is alive, then remove."""
    if container.state == "removing":
        return []
    steps = [stop(container, reason, service)] if container.alive else []
    return [*steps, Step("remove", container, reason)]


def stop(container: Container, reason: str, service: Service | None) -> Step:
    spec = (service.spec if service else None) or declared_of(container.declared)
    return Step("stop", container, reason, args={
        "signal": spec.get("stop_signal", "SIGTERM"),
        "grace": spec.get("stop_grace_period", DEFAULT_GRACE),
        "incarnation": container.incarnation,
    })
