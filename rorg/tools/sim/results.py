"""The results of a run of a trace, in the same form for simulations and emulations, and what collects them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

from rorg.core.changes import changed_keys
from rorg.core.decide import Decision
from rorg.core.memory import Memory
from rorg.core.requests import Problem
from rorg.model.catalog import Catalog
from rorg.model.graph import closure
from rorg.model.policy import Budget
from rorg.model.trace import TraceEvent
from rorg.model.units import format_memory, format_seconds
from rorg.tools.sim.contention import Shortage


@dataclass(frozen=True, slots=True)
class Sample:
    """The machine at one time."""

    at: float
    """Seconds since the trace began."""
    cpu: float
    """Mean number of cores since the last sample."""
    memory: int
    """Bytes, at this time."""
    active: frozenset[str]
    """Services that run."""
    paused: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Response:
    """How long a request took until everything in it was ready."""

    at: float
    requester: str
    id: str
    state: str
    """The state of the behaviour that made the request; empty for a request outside of any state."""
    seconds: float | None
    """None if it was released first, or never ready."""


@dataclass(frozen=True, slots=True)
class Violation:
    """Something that should not happen. `code` is stable."""

    at: float
    code: str
    """invariant, unready (wanted, but no longer ready), late, refused, over_budget."""
    service: str
    text: str


@dataclass(frozen=True, slots=True)
class RunResult:
    """One run of a trace on one robot."""

    name: str
    """The policy or setting that was tried, such as "rorg", "all on" or a policy."""
    duration: float
    samples: tuple[Sample, ...]
    responses: tuple[Response, ...] = ()
    violations: tuple[Violation, ...] = ()
    actions: Mapping[str, int] | None = None
    """Verb -> number of calls of the engine."""
    cpu_seconds: float | None = None
    """Core seconds over the run if they were summed up; otherwise they are estimated from the samples."""
    byte_seconds: float | None = None
    """Bytes times seconds, likewise."""
    shortage: Shortage | None = None
    """How short the CPU was; None if there was always enough by assumption."""

    @property
    def cpu(self) -> float:
        """Mean number of cores over the run."""
        if self.cpu_seconds is not None:
            return self.cpu_seconds / self.duration
        return self._mean([s.cpu for s in self.samples])

    @property
    def memory(self) -> float:
        """Mean number of bytes over the run."""
        if self.byte_seconds is not None:
            return self.byte_seconds / self.duration
        return self._mean([float(s.memory) for s in self.samples])

    @property
    def peak_memory(self) -> int:
        return max((s.memory for s in self.samples), default=0)

    @staticmethod
    def _mean(values: list[float]) -> float:
        return sum(values) / len(values) if values else 0.0


class Responses:
    """Collects one Response for each event that requests something, in order."""

    def __init__(self, catalog: Catalog) -> None:
        self.catalog = catalog
        self.found: list[Response] = []
        self._open: dict[tuple[str, str], tuple[int, frozenset[str]]] = {}
        """Request -> its index in `found`, and the services that must be ready."""

    def asked(self, event: TraceEvent) -> None:
        """A request is made, replaced or released."""
        key = event.requester, event.id
        self._open.pop(key, None)
        if event.services:
            members = (member for name in event.services for member in self.catalog.members(name))
            names = frozenset(n for n in closure(self.catalog.services, members) if not self.catalog.services[n].meta)
            self._open[key] = len(self.found), names
            self.found.append(Response(event.at, event.requester, event.id, event.state, None))

    def look(self, ready: Callable[[str], bool], now: float) -> None:
        """Notes the requests of which all services are ready."""
        for key, (index, names) in list(self._open.items()):
            if all(map(ready, names)):
                del self._open[key]
                self.found[index] = replace(self.found[index], seconds=now - self.found[index].at)


class Violations:
    """Collects violations. Each is reported once, when it begins."""

    def __init__(self, budget: Budget | None) -> None:
        self.budget = budget
        self.found: list[Violation] = []
        self._in_use, self._news = frozenset[str](), frozenset[str]()
        """Services that the trace wants, and those that it did not want before."""
        self._well: set[str] = set()
        """Services that were wanted and ready at the last look."""
        self._late: set[str] = set()
        """Incarnations that were reported as late."""
        self._over: set[str] = set()
        """What exceeds its budget: cpu, memory."""
        self._before = Memory()

    def wants(self, in_use: frozenset[str]) -> None:
        """Sets what the trace wants from now on, regardless of the policy."""
        self._well &= in_use
        self._news = in_use - self._in_use
        self._in_use = in_use

    def look(self, decision: Decision, now: float) -> None:
        """Called after every pass."""
        self.found += [Violation(now, "invariant", "", text) for text in decision.violations]
        memory, before = decision.memory, self._before
        calls = before.in_flight.keys() ^ memory.in_flight.keys()
        changed = changed_keys(before.progress, memory.progress) | calls | self._news
        self._before, self._news = memory, frozenset[str]()
        for name in sorted(changed):
            step = memory.of(name)
            if name in self._well and not step.ready:
                why = step.error or "it does not run"
                self.found.append(Violation(now, "unready", name, f"wanted, but no longer ready: {why}"))
                self._well.discard(name)
            elif name in self._in_use and step.ready and name not in memory.in_flight:
                self._well.add(name)
        self._check_late(decision, now)

    def _check_late(self, decision: Decision, now: float) -> None:
        for (name, role), target in decision.to_probe.items():
            since = decision.memory.of(name).running_since
            if role != "ready" or since is None or now < since + target.probe.timeout:
                continue
            if target.incarnation not in self._late and not decision.memory.of(name).ready:
                self._late.add(target.incarnation)
                after = format_seconds(target.probe.timeout)
                self.found.append(Violation(now, "late", name, f"not ready {after} after it was started"))

    def refused(self, now: float, requester: str, problems: Iterable[Problem]) -> None:
        text = "; ".join(problem.cause for problem in problems)
        self.found.append(Violation(now, "refused", requester, text))

    def used(self, now: float, cores: float, memory: float) -> None:
        """Checks the machine's use against the budget."""
        budget = self.budget
        if budget is None:
            return
        over = dict[str, str]()
        if budget.cpu is not None and cores > budget.cpu + 1e-9:
            over["cpu"] = f"{cores:.2f} cores are in use, the budget is {budget.cpu:g}"
        if budget.memory is not None and memory > budget.memory:
            over["memory"] = f"{format_memory(memory)} are in use, the budget is {format_memory(budget.memory)}"
        self.found += [Violation(now, "over_budget", "", text) for what, text in over.items() if what not in self._over]
        self._over = set(over)
