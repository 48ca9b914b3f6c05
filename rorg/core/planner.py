"""The one planner: make_plan(situation) -> Plan. Pure.

For each service it writes down the whole chain of engine calls that leads from what is observed to what is desired;
then it lets through what may happen, links what must wait for other actions of the plan, and turns the rest into
waitings with a reason.
"""

from __future__ import annotations

from rorg.core.digest import rules_of
from rorg.core.plan import Action, Plan, Waiting
from rorg.core.reconcile import ReconcileSteps
from rorg.core.situation import Situation
from rorg.core.steps import Step, away
from rorg.model.catalog import Service
from rorg.model.units import format_seconds


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
        self.steps = ReconcileSteps(situation, self.containers, self.last)
        self.leaving = self.leave_at_once()
        """Unwanted services that do not linger."""

    def plan(self) -> Plan:
        for name in sorted(self.steps.undeclared):
            self.undeclared(name)
        for name in reversed(self.desired.order):
            if name not in self.s.wanted:
                self.let_through(self.services[name])
        for name in self.desired.order:
            if name in self.s.wanted and not self.services[name].meta:
                self.let_through(self.services[name])
        self.waitings += [Waiting(name, reason, code="preempted") for name, reason in self.s.preempted.items()]
        self.waitings += [
            Waiting(name, f"its removal is withheld, since {why}; confirm it with `rorg apply`", code="withheld")
            for name, why in self.s.withheld.items()
        ]
        self.waitings += self.steps.notes
        if self.s.suspended:
            self.waitings.append(Waiting("rorg", self.s.suspended, code="suspended"))
        return Plan(tuple(self.actions), tuple(self.waitings), min(self.steps.alarms, default=None))

    def leave_at_once(self) -> set[str]:
        """What is in somebody's way, or must not be active; and what needs that."""
        found: set[str] = set()
        for name in self.desired.order:
            service = self.services[name]
            if name not in self.s.wanted and (
                name in self.s.preempted
                or name in self.s.excluded
                or any(o in self.s.wanted for o in self.desired.conflicts.get(name, ()))
                or any(n in found for n in service.needs)
                or self.steps.contested(service)
            ):
                found.add(name)
        return found

    def undeclared(self, name: str) -> None:
        """A service of ours that no manifest declares any more."""
        if name in self.s.memory.in_flight or name in self.s.withheld:
            return
        if not self.s.removals:
            self.waitings.append(Waiting(name, "not declared; its removal is withheld until the manifests load"))
            return
        steps = [s for c in self.containers[name] for s in away(c, "no manifest declares it", volumes=True)]
        self.emit(Service(name), steps)

    # -- what may happen now -----------------------------------------------------------------------------------

    def let_through(self, service: Service) -> None:
        name = service.name
        if service.meta:
            return
        flight = self.s.memory.in_flight.get(name)
        if flight:
            self.blocked[name] = f"{flight.action.verb} under way for {format_seconds(self.s.now - flight.since)}"
            return
        if any(c.state == "removing" for c in self.containers.get(name, [])):
            self.blocked[name] = "the engine is removing its container"
            self.waitings.append(Waiting(name, self.blocked[name]))
            return
        self.emit(service, self.steps.of(service))

    def emit(self, service: Service, steps: list[Step]) -> None:
        """Appends a chain's steps up to the first one that must wait. A name or an option that the engine refuses
        holds nothing back."""
        name = service.name
        for step in steps:
            after = () if name not in self.last else (self.last[name],)
            linked, waiting = self.gate(service, step)
            if waiting:
                self.waitings += [waiting] if waiting not in self.waitings else []
                if step.verb in ("update", "rename", "signal"):
                    continue
                self.blocked[name] = waiting.reason
                return
            self.last[name] = len(self.actions)
            self.actions.append(
                Action(
                    index=len(self.actions),
                    verb=step.verb,
                    service=name,
                    container=step.container.id if step.container else "",
                    reason=step.reason,
                    fields=step.fields,
                    after=tuple(dict.fromkeys(after + linked)),
                    args=step.args,
                    urgent=self.is_urgent(name, step),
                    priority=service.priority,
                    part_of=step.part_of,
                    surplus=step.surplus,
                )
            )

    def is_urgent(self, name: str, step: Step) -> bool:
        """What brings up a service that a live request waits for; not what replaces one that runs."""
        if name not in self.s.urgent:
            return False
        return step.verb in ("create", "rename", "start", "resume") and not any(
            c.active for c in self.containers.get(name, [])
        )

    def gate(self, service: Service, step: Step) -> tuple[tuple[int, ...], Waiting | None]:
        """Actions that this step must follow, or what it waits for."""
        memory = self.s.memory.of(service.name)
        tried = memory.attempts.get(step.verb)
        if tried and tried.at > self.s.now:
            wait = format_seconds(tried.at - self.s.now)
            word = "stalled" if memory.stalled else "failed"
            return (), Waiting(
                service.name, f"{step.verb} {word}: {tried.error or 'no effect'}; again in {wait}", tried.at, "failed"
            )
        swap = step.part_of == "replace" and step.verb in ("stop", "rename")
        locked = self.s.interlocks.get(service.name, "") if swap or step.verb not in ("create", "rename") else ""
        if locked:
            return (), Waiting(service.name, f"interlock: {locked}")
        begins = step.verb in ("start", "resume") or step.part_of
        limits = self.desired.catalog.policy.pressure
        if self.s.closed and limits and begins and self.s.priorities.get(service.name, 0) < limits.admit:
            return (), Waiting(service.name, self.s.closed)
        if step.verb in ("start", "resume") or (swap and service.name in self.s.wanted):
            return self.gate_start(service)  # what runs goes on until the new one can begin
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
        left = [n for n, cs in self.steps.undeclared.items() if service.name in rules_of(cs[0].rules).conflicts]
        for other in (*self.desired.conflicts.get(service.name, ()), *left):
            if any(c.active for c in self.containers.get(other, [])):
                if other not in self.last:
                    return (), Waiting(service.name, f"conflicts with {other}, which is active")
                after.append(self.last[other])
        for resource in service.exclusive:
            holders = self.holders(service, resource)
            if holders and all(h in self.last for h in holders):
                after += [self.last[h] for h in holders]
            elif holders:
                return (), Waiting(service.name, f"waits for {resource}, which {', '.join(holders)} still uses")
        return tuple(after), None

    def holders(self, service: Service, resource: str) -> list[str]:
        """Who must let go of an exclusive resource before this service can begin; a paused one still holds it."""
        users = [
            o
            for o in self.desired.sharers[resource]
            if o != service.name and any(c.alive for c in self.containers.get(o, []))
        ]
        left = self.steps.left_over(resource)
        used = service.exclusive[resource] + sum(self.steps.units(o, resource) for o in users) + sum(left.values())
        if used <= self.desired.catalog.policy.resources.get(resource, 1):
            return []
        return [*(o for o in users if o not in self.s.wanted), *left] or users

    def completed(self, need: str) -> bool:
        """It did what it was for, and ended well."""
        current = next(iter(self.containers.get(need, [])), None)
        return (
            current is not None and current.exit_code == 0 and self.s.memory.of(need).over(self.services[need], current)
        )

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
        seconds = None if ready is None else ready.timeout if ready.delay is None else ready.delay
        limit = "" if seconds is None else f" of {format_seconds(seconds)}"
        detail = f": {step.probe}" if step.probe else ""
        return f"is not ready ({format_seconds(self.s.now - step.running_since)}{limit}){detail}"

    def deadline(self, need: str) -> float | None:
        """When a needed service becomes ready by the clock alone."""
        step, ready = self.s.memory.of(need), self.services[need].ready if need in self.services else None
        if ready and ready.delay is not None and step.running_since is not None:
            return step.running_since + ready.delay
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
        until = (self.s.now if since is None else since) + service.idle.linger
        began = self.s.memory.of(service.name).running_since
        if began is not None:
            until = max(until, began + service.idle.min_active)
        if until > self.s.now and not self.s.hurry and service.name not in self.leaving:
            return (), Waiting(service.name, f"not wanted; lingers for {format_seconds(until - self.s.now)}", until)
        return tuple(after), None
