"""A robot in virtual time: the pass of the loop over the sim engine, deterministic."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Mapping

from rorg.core.decide import Decision, Inputs, decide
from rorg.core.desired import Desired, desire
from rorg.core.lanes import Lanes
from rorg.core.memory import Memory, Probe, finish
from rorg.core.observed import Observed
from rorg.core.plan import Action
from rorg.engines.execute import perform
from rorg.errors import RorgError
from rorg.manifest.catalog import Catalog
from rorg.sim.engine import Faults, SimEngine, iso
from rorg.store.requests_file import Asked

PROBE_AFTER = 0.1
"""Seconds after which a service with a probe answers it, unless ready_after says otherwise."""


class SimRobot:
    """Steps from event to event. `log` holds (time, text) of everything that happened."""

    def __init__(self, catalog: Catalog, owner: str = "sim") -> None:
        self.now = 0.0
        self.faults = Faults()
        self.engine = SimEngine(owner, lambda: self.now, self.faults)
        self.owner = owner
        self.desired: Desired = desire(catalog)
        self.asked = Asked()
        self.memory = Memory()
        self.ready_after: dict[str, float] = {}
        self.removals = True
        self.log: list[tuple[float, str]] = []
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = itertools.count()

    def declare(self, catalog: Catalog) -> None:
        self.desired = desire(catalog)

    def at(self, time: float, do: Callable[[], None]) -> None:
        heapq.heappush(self._events, (time, next(self._numbers), do))

    def step(self) -> Decision:
        """One pass now."""
        observed = Observed((), False, "the engine does not answer") if self.faults.unreachable else Observed(
            tuple(self.engine.list()))
        decision = decide(Inputs(
            self.desired, self.asked.requests, self.asked.restarts, observed, self._probes(), self.memory, self.now,
            self.owner, self.removals, lanes=Lanes(bulk=self.desired.catalog.policy.bulk_workers)))
        if decision.violations:
            raise AssertionError("; ".join(decision.violations))
        self.memory = decision.memory
        self.asked = Asked(decision.settled.requests, self.asked.restarts)
        for request, why in decision.settled.dropped:
            self.log.append((self.now, f"dropped {request.id}: {why}"))
        for action in decision.begin:
            self.at(self.now + self.engine.latency(action.verb, action.service), lambda a=action: self._finish(a))
        return decision

    def _finish(self, action: Action) -> None:
        error = ""
        try:
            perform(self.engine, action)  # type: ignore[arg-type]
        except RorgError as failed:
            error = failed.why
        self.log.append((self.now, str(action) + (f" failed: {error}" if error else "")))
        self.memory = finish(self.memory, action, error, action.args.get("incarnation", ""), self.now)
        if action.verb == "start" and not error and action.service in self.faults.crash_after:
            run = self.engine.containers[action.container].incarnation
            self.at(self.now + self.faults.crash_after[action.service], lambda: self._crash(action.container, run))

    def _crash(self, container: str, run: str) -> None:
        found = self.engine.containers.get(container)
        if found and found.alive and found.incarnation == run:
            self.engine.kill(container, 1)

    def _probes(self) -> Mapping[str, Probe]:
        found = {}
        for name, step in self.memory.progress.items():
            if step.running_since is not None:
                since = self.now - step.running_since
                ok = since >= self.ready_after.get(name, PROBE_AFTER)
                found[name] = Probe(step.incarnation, ok, self.now, "" if ok else "no answer")
        return found

    def run(self, until: Callable[[SimRobot], bool], limit: float = 600.0) -> Decision:
        """Goes on until the condition holds after a pass; AssertionError when `limit` seconds pass before."""
        end = self.now + limit
        while True:
            decision = self.step()
            if until(self):
                return decision
            times = [self._events[0][0]] if self._events else []
            times += [decision.deadline] if decision.deadline is not None else []
            times += [self.now + 0.05] if decision.to_probe else []
            if not times or min(times) > end:
                raise AssertionError(f"not so after {limit} s of virtual time:\n{decision.plan.text()}")
            self.now = max(self.now, min(times))
            while self._events and self._events[0][0] <= self.now:
                heapq.heappop(self._events)[2]()

    def settle(self, limit: float = 600.0) -> Decision:
        """Runs until nothing is left to do."""
        return self.run(lambda robot: robot.idle, limit)

    @property
    def idle(self) -> bool:
        decision = decide(Inputs(self.desired, self.asked.requests, self.asked.restarts,
                                 Observed(tuple(self.engine.list())), {}, self.memory, self.now, self.owner,
                                 self.removals))
        return decision.plan.empty and not self.memory.in_flight and not decision.to_probe

    def states(self) -> dict[str, str]:
        """Service -> state of its container."""
        return {c.service: c.state for c in self.engine.list()}

    def active(self) -> set[str]:
        return {c.service for c in self.engine.list() if c.state == "running"}


__all__ = ["SimRobot", "iso"]
