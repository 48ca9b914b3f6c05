"""A robot in virtual time whose programs behave as a workload says: they take time, use the machine, and crash."""

from __future__ import annotations

import heapq
from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil, inf

from rorg.core.changes import changed_items
from rorg.core.decide import Decision
from rorg.core.memory import ProbeResult
from rorg.core.observed import Container
from rorg.core.operations import Activate, Deactivate, Pause, Resume, Start
from rorg.core.plan import Action
from rorg.model.catalog import Catalog
from rorg.tools.sim.programs import Programs
from rorg.tools.sim.results import Sample, Violations
from rorg.tools.sim.robot import SimRobot


@dataclass(frozen=True, slots=True)
class Use:
    """What one container uses, starting at `since`."""

    service: str
    doing: tuple[str, bool, str]
    """Its state, whether it is in use, and when this run began: if one of them changes, so does its use."""
    cores: float
    memory: float
    """Bytes at `since`, without what it has grown by."""
    grew: float
    """Bytes that it had grown by at `since`."""
    growth: float
    """Bytes per second."""
    since: float

    @property
    def running(self) -> bool:
        return self.doing[0] == "running"

    def grown(self, now: float) -> float:
        """Bytes that it has grown by until now."""
        return self.grew + self.growth * (now - self.since)

    def memory_at(self, now: float) -> float:
        return self.memory + self.grown(now)


class MachineUse:
    """The sum over all containers. Samples are taken every `every` seconds, and at the end."""

    def __init__(self, every: float) -> None:
        self.every, self.now = every, 0.0
        self.cpu_seconds, self.byte_seconds = 0.0, 0.0
        self.samples: list[Sample] = []
        self._uses: dict[str, Use] = {}
        self._cores = self._memory = self._growth = 0.0
        """Current sums, with the memory as of `_since`."""
        self._since, self._stale = 0.0, False
        self._active, self._paused = frozenset[str](), frozenset[str]()
        self._sampled = 0.0, 0.0
        """Time of the last sample, and the CPU seconds at that time."""

    @property
    def cores(self) -> float:
        """Cores in use now."""
        if self._stale:
            self._sum()
        return self._cores

    @property
    def memory(self) -> float:
        """Bytes in use now."""
        if self._stale:
            self._sum()
        return self._memory + self._growth * (self.now - self._since)

    def by_service(self) -> dict[str, tuple[float, int]]:
        """Service -> cores and bytes in use now."""
        return {use.service: (use.cores, int(use.memory_at(self.now))) for use in self._uses.values()}

    def of(self, container: str) -> Use | None:
        return self._uses.get(container)

    def change(self, container: str, use: Use | None) -> None:
        """Sets what a container uses from now on; None if it has ended."""
        if use is None:
            self._uses.pop(container, None)
        else:
            self._uses[container] = use
        self._stale = True

    def _sum(self) -> None:
        """Updates the sums after changes at the current time."""
        uses = self._uses.values()
        self._since, self._cores = self.now, sum([u.cores for u in uses])
        self._memory, self._growth = sum([u.memory_at(self.now) for u in uses]), sum([u.growth for u in uses])
        self._active = frozenset([u.service for u in uses if u.running])
        self._paused = frozenset([u.service for u in uses if not u.running]) - self._active
        self._stale = False

    def advance(self, now: float) -> None:
        """Moves the time forward, and takes the samples that are due."""
        while (due := (len(self.samples) + 1) * self.every) <= now:
            self._add(due)
            self.sample()
        self._add(now)

    def _add(self, now: float) -> None:
        for_seconds = now - self.now
        before, cores = self.memory, self.cores
        self.cpu_seconds += cores * for_seconds
        self.now = now
        self.byte_seconds += (before + self.memory) / 2 * for_seconds

    def sample(self) -> None:
        """Takes a sample, unless there is one of this moment already."""
        at, seconds = self._sampled
        if self.now > at:
            mean = (self.cpu_seconds - seconds) / (self.now - at)
            self.samples.append(Sample(self.now, mean, round(self.memory), self._active, self._paused))
            self._sampled = self.now, self.cpu_seconds


ANSWER = 0.002
"""Seconds until a probe is answered."""


class RobotOfPrograms(SimRobot):
    """A SimRobot with programs. `every`: seconds between two samples of their use."""

    def __init__(self, catalog: Catalog, programs: Programs, every: float) -> None:
        super().__init__(catalog)
        self.programs, self.use = programs, MachineUse(every)
        self.violations = Violations(catalog.policy.budget)
        self.in_use: frozenset[str] = frozenset()
        """Services that currently do their work."""
        self._up: dict[str, float] = {}
        """Container -> when its program does its work; while it is paused, the seconds that it still needs."""
        self._began: dict[str, float] = {}
        """Container -> when it was last started or resumed."""
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
                answers[key] = ProbeResult(step.incarnation, ok, self.now, "" if ok else "no answer", 0 if ok else 1)
        return answers

    def _check(self, decision: Decision) -> None:
        """Violations of the plan are reported with all others."""

    def _latency(self, action: Action) -> float:
        return self.programs.call(action.verb, action.service)

    def _done(self, action: Action) -> None:
        container, now = action.container, self.now
        if isinstance(action.operation, Start):
            self._begin(container, self.programs.start(action.service), self.programs.life(action.service))
        elif isinstance(action.operation, (Pause, Deactivate)):
            self._up[container] = max(0.0, self._up[container] - now)
            self._life[container] -= now
        elif isinstance(action.operation, (Resume, Activate)):
            up = max(self._up[container], self.programs.resume(action.service))
            self._begin(container, up, self._life[container])

    def _begin(self, container: str, up: float, life: float) -> None:
        """Its program runs from now on, comes up after `up` seconds, and crashes after `life` seconds."""
        self._began[container], self._up[container], self._life[container] = self.now, self.now + up, self.now + life
        heapq.heappush(self._looks, self._up[container])
        service = self.desired.catalog.services.get(self.engine.containers[container].service)
        if service and service.ready and service.ready.completed:
            self.at(self._up[container], lambda: self._end(container, self._up, 0))
        if life < inf:
            self.at(self._life[container], lambda: self._end(container, self._life, 1))

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
        self.violations.used(self.now, self.use.cores, self.use.memory)

    def _account_for(self, id: str, container: Container | None) -> None:
        before = self.use.of(id)
        if container is None or not container.alive:
            if before is not None:
                self.use.change(id, None)
            return
        in_use, running = container.service in self.in_use, container.state == "running"
        doing = (container.state, in_use, container.started_at)
        if before is not None and before.doing == doing:
            return
        cores = self.programs.cores(container.service, in_use) if running else 0.0
        memory = self.programs.memory(container.service, container.state, in_use)
        grown = before.grown(self.use.now) if before is not None and before.doing[2] == doing[2] else 0.0
        growth = self.programs.growth(container.service) if running else 0.0
        self.use.change(id, Use(container.service, doing, cores, memory, grown, growth, self.use.now))
