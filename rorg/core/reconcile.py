"""What leads each service from what is observed to what is desired: chains of engine calls, not yet let through."""

from __future__ import annotations

from collections.abc import Container as Names
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from rorg.core.content import changed
from rorg.core.diff import Difference, difference
from rorg.core.digest import Rules, labels, rules_of
from rorg.core.observed import Container
from rorg.core.plan import Waiting
from rorg.core.pressure import LOWERED_SHARES
from rorg.core.rollout import candidate
from rorg.core.situation import Situation
from rorg.core.steps import Step, away, restarting, stop
from rorg.core.swap import Swap
from rorg.model.catalog import Service
from rorg.model.units import format_seconds

DEFAULT_SHARES = 1024
"""What an engine gives a container that declares no cpu_shares."""


class ReconcileSteps:
    """Of one situation. `moving` are the services that the plan already has actions for."""

    def __init__(self, situation: Situation, containers: Mapping[str, list[Container]], moving: Names[str]) -> None:
        self.s, self.desired, self.containers, self.moving = situation, situation.desired, containers, moving
        self.alarms: list[float] = []
        """Times at which something will be done that is no waiting of anybody's."""
        self.notes: list[Waiting] = []
        """What holds nothing back, and is worth telling."""
        services = situation.desired.catalog.services
        self.undeclared = {n: cs for n, cs in containers.items() if n not in services or services[n].meta}
        """Containers of services that no manifest declares, or not as having one."""

    def of(self, service: Service) -> list[Step]:
        """All steps of a service, from what is observed to what is desired."""
        name, spec = service.name, service.spec or {}
        pairs = [
            (c, difference(c, spec, self.desired.digests[name], self.desired.declared[name]))
            for c in self.containers.get(name, [])
        ]
        current = next(((c, d) for c, d in pairs if not d.recreate), None)
        stale = [(c, d) for c, d in pairs if current is None or c is not current[0]]
        swap = Swap(self.s, service, current and current[0], [c for c, _ in stale])
        if swap.stays and swap.old:
            return self.stay(service, swap, current, stale)
        if not (name in self.s.wanted or self.keeps(service, current is not None)):
            return self.clear(service, pairs, False)
        steps: list[Step] = []
        new_name = ""
        if current is None:
            new_name = self.free_name(service, [c for c, _ in stale])
            steps.append(self.create(service, new_name, stale, swap.old))
        steps += self.clear(service, [p for p in stale if p[0] is not swap.old], True)
        if swap.old:
            steps += self.make_room(service, swap.old)
        if current:
            steps += self.adjust(service, *current)
        elif new_name != service.container_name:
            steps.append(Step("rename", None, "it takes its name", args={"name": service.container_name}))
        if swap.old and swap.old.alive:
            steps.append(stop(swap.old, "changed", service))
        steps += self.run(service, current and current[0], steps)
        if swap.old:
            trial = {"trial": self.desired.editions[name]}
            steps = [replace(s, args={**s.args, **trial}) if s.verb == "start" else s for s in steps]
        if swap.under_way:
            self.notes += [swap.note()] if name in self.s.wanted else []
        elif swap.old or any(diff.recreate for _, diff in stale):
            return [replace(s, part_of="replace") for s in steps]
        return restarting(current and current[0], steps)

    def stay(
        self,
        service: Service,
        swap: Swap,
        current: tuple[Container, Difference] | None,
        stale: list[tuple[Container, Difference]],
    ) -> list[Step]:
        """The new container cannot be had, or did not come up: the one before it goes on, or again."""
        old, new = swap.old, current and current[0]
        assert old is not None
        if swap.failed:
            self.notes.append(Waiting(service.name, swap.failed, code="failed"))
        if not (service.name in self.s.wanted or self.keeps(service, True)):
            return self.clear(service, [p for p in (*stale, current) if p], False)
        why = f"back to the one before: {swap.update.error}" if swap.failed else "changed"
        steps = [stop(new, why, service)] if new and new.alive else []
        steps += [s for s in self.adjust(service, old, Difference()) if new is None or s.verb != "rename"]
        steps += self.run(service, old, steps)
        left = [c for c, _ in stale if c is not old] + ([] if new is None else [new])
        steps += [s for c in left for s in away(c, why, service) if s.verb == "remove" or c is not new]
        steps = [replace(s, args={"words": True}) if s.verb == "remove" and s.container is new else s for s in steps]
        if left:
            return [replace(s, part_of="replace", reason=why) for s in steps]
        steps = restarting(old, steps)
        return steps if swap.failed else [*steps, self.create(service, self.free_name(service, [old]), stale, old)]

    def run(self, service: Service, container: Container | None, steps: list[Step]) -> list[Step]:
        """What makes it active, or ceases it."""
        if service.name in self.s.wanted:
            return self.wake(service, container, steps)
        return self.cease(service, container) if container else []

    def make_room(self, service: Service, old: Container) -> list[Step]:
        """The name of the service is for the new container; the old one keeps a passing one."""
        if old.name != service.container_name:
            return []
        name = f"{service.container_name}.{old.digest.partition(':')[2][:8] or old.id[:8]}"
        return [Step("rename", old, "changed", args={"name": name})]

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

    def create(
        self, service: Service, name: str, stale: list[tuple[Container, Difference]], old: Container | None
    ) -> Step:
        """`old` is to be gone back to if the new one does not come up."""
        spec = service.spec or {}
        fields = tuple(sorted({f for _, d in stale for f in d.recreate}))
        marks = labels(self.s.owner, service.name, spec, self.rules(service), old.id if old else "")
        before = old or next((c for c, _ in stale), None)
        return Step(
            "create",
            None,
            "changed" if stale else "no container",
            fields,
            {
                "name": name,
                "spec": spec,
                "labels": marks,
                "digest": self.desired.digests[service.name],
                "before": before.id if before else "",
                "defaults": service.defaults,
            },
        )

    def rules(self, service: Service) -> Rules:
        return Rules(service.interlock, service.exclusive, self.desired.conflicts[service.name])

    def clear(self, service: Service, stale: list[tuple[Container, Difference]], keep: bool) -> list[Step]:
        """The way out for containers that are not (or no longer) the service's one."""
        steps: list[Step] = []
        for container, diff in stale:
            reason = "changed" if diff.recreate else "a second container of this service"
            way = away(container, reason if keep else "not wanted", service, volumes=not keep)
            steps += [replace(step, surplus=keep and not diff.recreate) for step in way]
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
        why, now = self.restart(service, container), self.desired.contents.get(service.name, {})
        if (
            container.state == "running"
            and service.name in self.s.wanted
            and service.on_change not in ("restart", "none")
            and (paths := changed(self.s.memory.of(service.name).update, container, now))
        ):
            steps.append(
                Step(
                    "signal",
                    container,
                    "changed",
                    paths,
                    {"signal": service.on_change, "content": dict(now), "incarnation": container.incarnation},
                )
            )
        if why:
            steps.append(stop(container, why, service))
        return steps

    def next_name(self, service: Service) -> str:
        """The name to take now: the service's own, or a passing one while another service's container has that, which
        may be waiting for the name of this one."""
        taken = any(c.name == service.container_name and c.service != service.name for c in self.s.observed.containers)
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
        paths = changed(memory.update, container, self.desired.contents.get(service.name, {}))
        if paths and service.on_change == "restart":
            return f"changed: {', '.join(paths)}"
        for need in service.restarts_with:
            current = next(iter(self.containers.get(need, [])), None)
            # Its readiness is waited for, since what ends now still wants to say goodbye to it.
            if (
                current
                and current.state == "running"
                and memory.counted_on.lost(need, container, current)
                and need not in self.moving
                and self.s.memory.of(need).ready
                and not self.tried(need)
            ):
                return f"{need} was restarted"
        return ""

    def tried(self, name: str) -> bool:
        """Whether a new container of it is on trial: it may yet be that the one before comes back."""
        return candidate(self.containers[name], self.s.memory.of(name).update) is not None

    def wake(self, service: Service, container: Container | None, steps: list[Step]) -> list[Step]:
        why = str(self.s.wanted[service.name][0])
        runs = {
            n: cs[0].incarnation for n in service.restarts_with if (cs := self.containers.get(n)) and cs[0].started_at
        }
        start: dict[str, Any] = {"counts_on": runs} if runs else {}
        if service.name in self.desired.contents:
            start["content"] = dict(self.desired.contents[service.name])
        if container is None or any(s.verb == "stop" and s.container is container for s in steps):
            return [Step("start", container, why, args=start)]
        if container.state == "paused":
            return [Step("resume", container, why)]
        if container.active:
            return []
        if container.state == "dead":
            return [Step("remove", container, "the engine calls it dead", surplus=True)]
        step = self.s.memory.of(service.name)
        if step.over(service, container) and self.s.restarts.get(service.name) != container.incarnation:
            return []
        if container.state == "exited" and step.exited == container.incarnation:
            why += f"; {step.error}"
        return [Step("start", container, why, args=start)]

    def cease(self, service: Service, container: Container) -> list[Step]:
        """A service that nobody wants: as its idle policy says. (Removal is chain()'s: nothing is kept then.)"""
        why = self.s.preempted.get(service.name, "not wanted")
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
            return away(container, why, service, volumes=True)
        return [stop(container, why, service)] if container.alive else []

    def contested(self, service: Service) -> bool:
        """It holds an exclusive resource, even when paused, that a wanted service waits for."""
        for resource, units in service.exclusive.items():
            sharers = [o for o in self.desired.sharers[resource] if o != service.name]
            used = units + sum(self.units(o, resource) for o in sharers if self.alive(o))
            used += sum(self.left_over(resource).values())
            there = self.desired.catalog.policy.resources.get(resource, 1)
            if any(
                used + (0 if self.alive(o) else self.units(o, resource)) > there
                for o in sharers
                if o in self.s.wanted and not self.done(o)
            ):
                return True
        return False

    def left_over(self, resource: str) -> dict[str, int]:
        """Services that no manifest declares any more, and still hold units of an exclusive resource."""
        return {
            name: units
            for name, cs in self.undeclared.items()
            if self.alive(name) and (units := rules_of(cs[0].rules).exclusive.get(resource, 0))
        }

    def units(self, name: str, resource: str) -> int:
        return self.desired.catalog.services[name].exclusive[resource]

    def alive(self, name: str) -> bool:
        return any(c.alive for c in self.containers.get(name, []))

    def done(self, name: str) -> bool:
        """It ended, and its restart policy leaves it at that."""
        current = next(iter(self.containers.get(name, [])), None)
        service = self.desired.catalog.services[name]
        return current is not None and self.s.memory.of(name).over(service, current)
