"""A robot in virtual time whose programs behave as a workload says: they take time, use the machine, and crash."""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from functools import partial
from math import ceil, inf

from rorg.core.changes import changed_items
from rorg.core.decide import Decision
from rorg.core.memory import ProbeResult
from rorg.core.observed import Container
from rorg.core.operations import Activate, Deactivate, Pause, Resume, Start
from rorg.core.plan import Action
from rorg.core.steps import DEFAULT_SHARES
from rorg.model.catalog import Catalog
from rorg.tools.sim.machine_use import MachineUse, Use
from rorg.tools.sim.programs import Programs
from rorg.tools.sim.results import Violations
from rorg.tools.sim.robot import SimRobot

ANSWER = 0.002
"""Seconds until a probe is answered."""


class RobotOfPrograms(SimRobot):
    """A SimRobot with programs. `every`: seconds between two samples of their use. `cores`: of the machine; programs
    come up more slowly while they want more. None: there are always enough."""

    def __init__(self, catalog: Catalog, programs: Programs, every: float, cores: float | None = None) -> None:
        super().__init__(catalog)
        self.programs, self.use = programs, MachineUse(every, cores)
        self.violations = Violations(catalog.policy.budget)
        self.in_use: frozenset[str] = frozenset()
        """Services that currently do their work."""
        self._up: dict[str, float] = {}
        """Container -> when its program does its work; while it is paused, the seconds that it still needs."""
        self._began: dict[str, float] = {}
        """Container -> when it was last started or resumed."""
        self._starting: set[str] = set()
        """Containers that come up after a start, of services whose CPU meanwhile is known."""
        self._speed: dict[str, float] = {}
        """Container -> the part of its CPU that it gets, if that is not all."""
        self._life: dict[str, float] = {}
        """Container -> when it crashes; while it is paused, the remaining seconds."""
        self._looks: list[float] = []
        """When programs come up. The loop does not need to know."""
        self._accounted: tuple[Container, ...] = ()

    def _asked_next(self) -> float:
        """When a probe has a new answer."""
        times = [inf]
        for (name, role), target in self._asked.items():
            told = self._told.get((name, role))
            if role == "interlock" and told is None:
                times.append(self.now + ANSWER)
            elif role == "ready" and not (told and told.ok and told.incarnation == target.incarnation):
                times.append(max(self._answers_at(target.container, target.every), self.now + ANSWER))
        return min(times)

    def _answers_at(self, container: Container | None, every: float) -> float:
        """When a run answers a probe for the first time."""
        if container is None or container.state != "running":
            return inf
        began, up = self._began[container.id], self._up[container.id]
        if self.programs.workload.probed:
            return up
        return began + ceil(max(0.0, up - began) / every - 1e-9) * every

    def _findings(self) -> Mapping[tuple[str, str], ProbeResult]:
        answers = {}
        for key, target in self._asked.items():
            step, told = self.memory.of(key[0]), self._told.get(key)
            since = step.running_since
            if key[1] == "interlock":
                answers[key] = ProbeResult("", True, self.now)
            elif since is None or step.incarnation != target.incarnation:
                continue
            elif told and told.ok and told.incarnation == step.incarnation and told.at >= since:
                answers[key] = told
            else:
                ok = key[1] == "live" or self.now >= self._answers_at(target.container, target.every)
                answers[key] = ProbeResult(
                    step.incarnation, ok, self.now, "" if ok else "no answer", 0 if ok else 1, target.probe
                )
        return answers

    def _check(self, decision: Decision) -> None:
        """Violations of the plan are reported with all others."""

    def _latency(self, action: Action) -> float:
        return self.programs.call(action.verb, action.service)

    def _done(self, action: Action) -> None:
        container, now = action.container, self.now
        if isinstance(action.operation, Start):
            if self.programs.starting_cores(action.service) is not None:
                self._starting.add(container)
            self._begin(container, self.programs.start(action.service), self.programs.life(action.service))
        elif isinstance(action.operation, (Pause, Deactivate)):
            self._up[container] = max(0.0, self._up[container] - now) * self._speed.pop(container, 1.0)
            self._life[container] -= now
        elif isinstance(action.operation, (Resume, Activate)):
            up = max(self._up[container], self.programs.resume(action.service))
            self._begin(container, up, self._life[container])

    def _begin(self, container: str, up: float, life: float) -> None:
        """Its program runs from now on, comes up after `up` seconds, and crashes after `life` seconds."""
        self._began[container], self._life[container] = self.now, self.now + life
        self._speed.pop(container, None)
        self._expect(container, self.now + up)
        if life < inf:
            self.at(self._life[container], lambda: self._end(container, self._life, 1))

    def _expect(self, container: str, up: float) -> None:
        """Its program comes up at this time, unless that changes again."""
        self._up[container] = up
        heapq.heappush(self._looks, up)
        service = self.desired.catalog.services.get(self.engine.containers[container].service)
        if service and service.ready and service.ready.completed:
            self.at(up, lambda: self._end(container, self._up, 0))
        if container in self._starting:
            self.at(up, partial(self._came_up, container))

    def _came_up(self, container: str) -> None:
        """Its CPU is no longer that of a program that comes up. A pause may have put that off."""
        observed = self.engine.containers.get(container)
        if observed and observed.state == "running" and self._up[container] <= self.now:
            self._starting.discard(container)
            self._accounted = ()

    def _adjust(self) -> None:
        """Programs that come up need longer, or less long, since they now get another part of their CPU."""
        for container, speed in self.use.speeds().items():
            before = self._speed.get(container, 1.0)
            if speed != before:
                self._speed[container] = speed
                if self._up[container] > self.now:
                    self._expect(container, self.now + (self._up[container] - self.now) * before / speed)

    def _end(self, container: str, times: Mapping[str, float], code: int) -> None:
        """Ends a running container if its time has come. A pause may have put it off."""
        observed = self.engine.containers.get(container)
        if observed and observed.state == "running" and times[container] <= self.now:
            self.engine.kill(container, code)

    def _account(self) -> None:
        """Updates the use of containers that have changed."""
        containers = tuple(self.engine.list())
        went, came = changed_items(self._accounted, containers)
        if not (went or came):
            return
        for one in dict.fromkeys(c.id for c in (*went, *came)):
            self._account_for(one, self.engine.containers.get(one))
        self._accounted = containers
        self._adjust()
        self.violations.used(self.now, self.use.cores, self.use.memory)

    def _account_for(self, id: str, container: Container | None) -> None:
        before = self.use.of(id)
        if container is None or not container.alive:
            if before is not None:
                self.use.change(id, None)
            return
        in_use, running = container.service in self.in_use, container.state == "running"
        doing = (container.state, in_use, container.started_at, id in self._starting)
        shares = container.live.get("cpu_shares") or DEFAULT_SHARES
        if before is not None and (before.doing, before.shares) == (doing, shares):
            return
        cores = self.programs.cores(container.service, in_use, id in self._starting) if running else 0.0
        memory = self.programs.memory(container.service, container.state, in_use)
        grown = before.grown(self.use.now) if before is not None and before.doing[2] == doing[2] else 0.0
        growth = self.programs.growth(container.service) if running else 0.0
        self.use.change(id, Use(container.service, doing, cores, memory, grown, growth, self.use.now, shares))
