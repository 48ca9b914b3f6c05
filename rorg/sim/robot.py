"""A robot in virtual time: the pass of the loop over the sim engine, deterministic."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

from rorg.core.decide import Decision, decide
from rorg.core.desired import Desired, desire
from rorg.core.dispatch import DispatchLimits
from rorg.core.found_objects import FoundObjects
from rorg.core.inputs import Cache, Inputs
from rorg.core.memory import Memory, ProbeResult
from rorg.core.observed import Container, Observed
from rorg.core.operations import Start
from rorg.core.outcomes import Outcome, finish
from rorg.core.plan import Action
from rorg.core.ros_graph import Graphs
from rorg.core.ros_parameters import ROLE
from rorg.core.schedule import Target
from rorg.engines.execute import failure, perform
from rorg.errors import RorgError
from rorg.model.catalog import Catalog
from rorg.model.learned import Learned
from rorg.model.load import Load
from rorg.sim.engine import EPOCH, Faults, SimEngine, iso
from rorg.store.requests_document import RequestsDocument

PROBE_AFTER = 0.1
"""Seconds after which a service with a probe answers it, unless ready_after says otherwise."""

CORES, MEMORY = 4.0, 8 << 30
"""Of the machine, where the policy's budget says nothing else."""

OFTEN = 0.05
"""Seconds between passes while probes may tell something new."""


class SimRobot:
    """Steps from event to event. `log` holds (time, text) of everything that happened."""

    def __init__(self, catalog: Catalog, owner: str = "sim") -> None:
        self.now = 0.0
        self.faults = Faults()
        self.clock_set = 0.0
        """Seconds by which the machine's clock was set since."""
        self.engine = SimEngine(owner, lambda: self.now + self.clock_set, self.faults)
        self.owner = owner
        self.desired: Desired = desire(catalog)
        self.document = RequestsDocument()
        self.memory = Memory()
        self.cache: Cache | None = None
        self.ready_after: dict[str, float] = {}
        self.hung: set[str] = set()
        """Incarnations that do not answer their `live` probe."""
        self.locked: set[str] = set()
        """Services whose interlock says no."""
        self.extra: tuple[float, int] = (0.0, 0)
        """(cores, bytes) that other programs of the machine use."""
        self.learned: Learned | None = None
        """What was learnt before of requests; None: nothing is prewarmed."""
        self.ros: Graphs = {}
        """What ROS 1 masters say."""
        self.renewals: dict[tuple[str, str], int] = {}
        self._sample: Load | None = None
        self._seen: tuple[Container, ...] = ()
        self._found = FoundObjects()
        self._asked: Mapping[tuple[str, str], Target] = {}
        """What the last pass wanted to be probed."""
        self._told: Mapping[tuple[str, str], ProbeResult] = {}
        """What probes told the last pass."""
        self.removals = True
        self.booted_at = ""
        self.life = 0
        """How often another rorg took over."""
        self.log: list[tuple[float, str]] = []
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = itertools.count()

    def declare(self, catalog: Catalog) -> None:
        self.desired = desire(catalog)

    @property
    def wall(self) -> float:
        """Virtual now, in seconds since the epoch."""
        return EPOCH + self.now + self.clock_set

    def at(self, time: float, do: Callable[[], None]) -> None:
        heapq.heappush(self._events, (time, next(self._numbers), do))

    def step(self) -> Decision:
        """One pass now."""
        inputs = self.inputs()
        decision = decide(inputs)
        self.decision, self._asked, self._told = decision, decision.to_probe, inputs.results
        self._check(decision)
        self.memory, self.cache = decision.memory, decision.cache
        left = {n: at for n, at in self.document.restarts.items() if n not in decision.served}
        self.document = replace(
            self.document,
            requests=decision.settled.requests,
            restarts=left,
            retries={n: at for n, at in self.document.retries.items() if n not in decision.retried},
            removals=tuple(n for n in self.document.removals if n not in decision.confirmed),
        )
        for request, why in decision.settled.dropped:
            self.log.append((self.now, f"dropped {request.id}: {why}"))
        for action in decision.begin:
            self.at(self.now + self._latency(action), partial(self._finish, action, self.life))
        return decision

    def _check(self, decision: Decision) -> None:
        if decision.violations:
            raise AssertionError("; ".join(decision.violations))

    def _latency(self, action: Action) -> float:
        """Seconds that its call takes."""
        return self.engine.latency(action.verb, action.service)

    def reborn(self, memory: Memory) -> None:
        """Another rorg takes over. What the one before had begun is done, and nobody hears of the outcome."""
        self.life += 1
        self.memory, self.cache = memory, None

    def _finish(self, action: Action, life: int) -> None:
        outcome = Outcome(action)
        try:
            perform(self.engine, action.operation)
        except RorgError as failed:
            outcome = failure(action, failed)
        self.log.append((self.now, str(action) + (f" failed: {outcome.error}" if outcome.error else "")))
        if life == self.life:
            self.memory = finish(self.memory, [outcome], self.now)
        if not outcome.error:
            self._done(action)

    def _done(self, action: Action) -> None:
        """A call has had its effect."""
        if isinstance(action.operation, Start):
            found = self.engine.containers[action.container]
            after = 0.5 if found.digest in self.faults.bad else self.faults.crash_after.get(action.service)
            if after is not None:
                self.at(self.now + after, lambda: self._crash(found.id, found.incarnation))

    def _crash(self, container: str, run: str) -> None:
        found = self.engine.containers.get(container)
        if found and found.alive and found.incarnation == run:
            self.engine.kill(container, self.faults.exit_code)

    def inputs(self) -> Inputs:
        """What a pass would read now."""
        if not self.faults.unreachable:
            self._seen, self._found = tuple(self.engine.list()), self.engine.find_objects(self.desired.keys)
        unanswered = "the engine does not answer" if self.faults.unreachable else ""
        looked = {c.id: self.now for c in self._seen}
        observed = Observed(self._seen, not self.faults.unreachable, unanswered, self._found, looked)
        return Inputs(
            desired=self.desired,
            requests=self.document.requests,
            restarts=self.document.restarts,
            observed=observed,
            results=self._findings(),
            memory=self.memory,
            now=self.now,
            owner=self.owner,
            removals=self.removals,
            booted_at=self.booted_at,
            limits=DispatchLimits().allowing(self.desired.catalog.policy.bulk_workers),
            holds=self.document.holds,
            suspended=self.document.suspended,
            wall=self.wall,
            load=self._load(),
            renewals=self.renewals,
            confirmed=self.document.removals,
            retries=self.document.retries,
            learned=self.learned,
            cache=self.cache,
            ros=self.ros,
            devices={
                d: self.engine.devices[d.identity] for d in self.desired.devices if d.identity in self.engine.devices
            },
        )

    def _findings(self) -> Mapping[tuple[str, str], ProbeResult]:
        """Answers to what the last pass asked."""
        found = {}
        for (name, role), target in self._asked.items():
            step = self.memory.of(name)
            if role == "interlock":
                ok = name not in self.locked
                found[name, role] = ProbeResult("", ok, self.now, "" if ok else "not allowed")
            elif role == ROLE:
                found[name, role] = ProbeResult(target.incarnation, True, self.now)
            elif step.running_since is not None and step.incarnation == target.incarnation:
                late = self.now - step.running_since < self.ready_after.get(name, PROBE_AFTER)
                ok = step.incarnation not in self.hung and not (role == "ready" and late)
                found[name, role] = ProbeResult(
                    step.incarnation, ok, self.now, "" if ok else "no answer", 0 if ok else 1000
                )
        return found

    def _until_asked_again(self) -> float:
        """Seconds until the next pass for the sake of probes: soon, unless all have told the last one what they tell
        now, and only an event makes them tell something else: who is not ready yet gets ready by time alone."""
        found = self._findings()
        steady = all(
            (answer := found.get(key)) is not None
            and (answer.ok or key[1] != "ready")
            and (told := self._told.get(key)) is not None
            and (told.incarnation, told.ok) == (answer.incarnation, answer.ok)
            and told.at >= (target.asked or 0.0)
            for key, target in self._asked.items()
        )
        return min(target.every for target in self._asked.values()) if steady else OFTEN

    def _load(self) -> Load | None:
        """Everything that runs uses what it declares, `extra` comes on top."""
        limits = self.desired.catalog.policy.pressure
        if limits is None:
            return None
        if self._sample is None or self.now >= self._sample.at + limits.step:
            use = self._use()
            cores, memory = (sum(u[0] for u in use.values()), sum(u[1] for u in use.values()))
            self._sample = Load(self.now, self.extra[0] + cores, CORES, self.extra[1] + memory, MEMORY, use=use)
        return self._sample

    def _use(self) -> dict[str, tuple[float, int]]:
        """Service -> cores and bytes that it uses now."""
        services = self.desired.catalog.services
        return {
            c.service: (services[c.service].cpu if c.state == "running" else 0.0, services[c.service].memory)
            for c in self.engine.list()
            if c.alive and c.service in services
        }

    def run(self, until: Callable[[SimRobot], bool], limit: float = 600.0) -> Decision:
        """Goes on until the condition holds after a pass; AssertionError when `limit` seconds pass before."""
        end = self.now + limit
        while True:
            decision = self.step()
            if until(self):
                return decision
            times = [self._events[0][0]] if self._events else []
            times += [decision.deadline] if decision.deadline is not None else []
            times += [self.now + self._until_asked_again()] if decision.to_probe else []
            times += [self.now + OFTEN] if decision.to_look else []
            limits = self.desired.catalog.policy.pressure
            times += [self.now + limits.step] if limits else []
            if not times or min(times) > end:
                raise AssertionError(f"not so after {limit} s of virtual time:\n{decision.plan.text()}")
            self.now = max(self.now, min(times))
            self._happen()

    def _happen(self) -> None:
        """What is due by now."""
        while self._events and self._events[0][0] <= self.now:
            heapq.heappop(self._events)[2]()

    def settle(self, limit: float = 600.0) -> Decision:
        """Runs until nothing is left to do."""
        return self.run(lambda robot: robot.idle, limit)

    @property
    def idle(self) -> bool:
        decision = decide(self.inputs())
        probing = any(role == "ready" for _, role in decision.to_probe)
        return decision.plan.empty and not self.memory.in_flight and not probing

    def states(self) -> dict[str, str]:
        """Service -> state of its container."""
        return {c.service: c.state for c in sorted(self.engine.list(), key=lambda c: (c.alive, c.started_at))}

    def active(self) -> set[str]:
        return {c.service for c in self.engine.list() if c.state == "running"}


__all__ = ["SimRobot", "iso"]
