"""What should not be, in a run."""

from __future__ import annotations

from collections.abc import Iterable

from rorg.core.changes import changed_keys
from rorg.core.decide import Decision
from rorg.core.memory import Memory
from rorg.core.requests import Problem
from rorg.model.policy import Budget
from rorg.model.units import format_memory, format_seconds
from rorg.sim.results import Violation


class Violations:
    """Each is told once, when it begins."""

    def __init__(self, budget: Budget | None) -> None:
        self.budget = budget
        self.found: list[Violation] = []
        self._in_use, self._news = frozenset[str](), frozenset[str]()
        """What the trace wants, and what of it is new."""
        self._well: set[str] = set()
        """Services that were wanted and ready at the last look."""
        self._late: set[str] = set()
        """Incarnations that were told to be late."""
        self._over: set[str] = set()
        """What is above its budget: cpu, memory."""
        self._before = Memory()

    def wants(self, in_use: frozenset[str]) -> None:
        """What the trace wants from now on, whatever the policy makes of it."""
        self._well &= in_use
        self._news = in_use - self._in_use
        self._in_use = in_use

    def look(self, decision: Decision, now: float) -> None:
        """After a pass."""
        self.found += [Violation(now, "invariant", "", text) for text in decision.violations]
        memory, before = decision.memory, self._before
        calls = before.in_flight.keys() ^ memory.in_flight.keys()
        changed = changed_keys(before.progress, memory.progress) | calls | self._news
        self._before, self._news = memory, frozenset[str]()
        for name in sorted(changed):
            step = memory.of(name)
            if name in self._well and not step.ready:
                why = step.error or "it does not run"
                self.found.append(Violation(now, "unready", name, f"wanted, and not ready any more: {why}"))
                self._well.discard(name)
            elif name in self._in_use and step.ready and name not in memory.in_flight:
                self._well.add(name)
        self._late_ones(decision, now)

    def _late_ones(self, decision: Decision, now: float) -> None:
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
        """The machine's use has changed."""
        budget = self.budget
        if budget is None:
            return
        over = dict[str, str]()
        if budget.cpu is not None and cores > budget.cpu + 1e-9:
            over["cpu"] = f"{cores:.2f} cores are used of a budget of {budget.cpu:g}"
        if budget.memory is not None and memory > budget.memory:
            over["memory"] = f"{format_memory(memory)} are used of a budget of {format_memory(budget.memory)}"
        self.found += [Violation(now, "over_budget", "", text) for what, text in over.items() if what not in self._over]
        self._over = set(over)
