"""A robot in virtual time: the loop's pass over the sim engine, deterministic."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

from rorg.core.decide import Decision, decide
from rorg.core.desired import Desired, desire
from rorg.core.dispatch import DispatchLimits, Outcome, finish
from rorg.core.holds import Moment
from rorg.core.inputs import Cache, Inputs
from rorg.core.memory import Memory, ProbeResult
from rorg.core.observed import Container, FoundObjects, Observed
from rorg.core.operations import Start
from rorg.core.plan import Action
from rorg.core.ros_graph import Graphs
from rorg.core.ros_parameters import ROLE
from rorg.core.schedule import Target
from rorg.engines.execute import failure, perform
from rorg.errors import RorgError
from rorg.model.catalog import Catalog
from rorg.model.load import Load
from rorg.store.requests_document import RequestsDocument
from rorg.tools.sim.calls import Faults
from rorg.tools.sim.engine import EPOCH, SimEngine

PROBE_AFTER = 0.1
"""Seconds after which a service answers its probe, unless ready_after says otherwise."""

CORES, MEMORY = 4.0, 8 << 30
"""Of the machine, unless the policy has a budget."""

OFTEN = 0.05
"""Seconds between passes while probes may have new answers."""


class LookedAt(dict[str, float]):
    """Every container was looked at now."""

    def __init__(self, now: float) -> None:
        self.now = now

    def get(self, _container: str, _otherwise: float | None = None) -> float:  # type: ignore[override]
        return self.now


class SimRobot:
    """Steps from event to event. `log` holds (time, text) of everything that happened."""

    def __init__(self, catalog: Catalog, owner: str = "sim") -> None:
        self.now = 0.0
        self.faults = Faults()
        self.clock_set = 0.0
        """Seconds by which the machine's clock was changed."""
        self.engine = SimEngine(owner, lambda: self.now, self.faults, lambda: self.now + self.clock_set)
        self.owner = owner
        self.desired: Desired = desire(catalog)
        self.document = RequestsDocument()
        self.memory = Memory()
        self.cache: Cache | None = None
        self.ready_after: dict[str, float] = {}
        self.hung: set[str] = set()
        self.deaf: set[str] = set()
        """Questions of probes that nothing answers, as `tcp 80`."""
        """Incarnations that do not answer their `live` probe."""
        self.locked: set[str] = set()
        """Services whose interlock refuses."""
        self.extra: tuple[float, int] = (0.0, 0)
        """(cores, bytes) that other programs of the machine use."""
        self.ros: Graphs = {}
        """Answers of ROS 1 masters."""
        self.renewals: dict[tuple[str, str], int] = {}
        self._sample: Load | None = None
        self._seen: tuple[Container, ...] = ()
        self._found = FoundObjects()
        self._asked: Mapping[tuple[str, str], Target] = {}
        """Probes that the last pass wanted."""
        self._told: Mapping[tuple[str, str], ProbeResult] = {}
        """Answers that the last pass received."""
        self.removals = True
        self.boot = ""
        self.life = 0
        """How often a new rorg process took over."""
        self.log: list[tuple[float, str]] = []
        self._events: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = itertools.count()

    def declare(self, catalog: Catalog) -> None:
        self.desired = desire(catalog)

    @property
    def wall(self) -> float:
        """The virtual time, in seconds since the epoch."""
        return EPOCH + self.now + self.clock_set

    @property
    def moment(self) -> Moment:
        """The present, by all clocks."""
        return Moment(self.wall, self.now, self.boot)

    def at(self, time: float, do: Callable[[], None]) -> None:
        heapq.heappush(self._events, (time, next(self._numbers), do))

    def step(self) -> Decision:
        """Runs one pass now."""
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
        """Seconds that the call takes."""
        return self.engine.latency(action.verb, action.service)

    def reborn(self, memory: Memory) -> None:
        """A new rorg process takes over. Calls of the previous one are completed, but no one receives their
        outcomes. It has seen none of the starts."""
        self.life += 1
        self.engine.containers = {c: replace(one, start_number=0) for c, one in self.engine.containers.items()}
        self.memory, self.cache = memory, None

    def _finish(self, action: Action, life: int) -> None:
        outcome = Outcome(action)
        try:
            perform(self.engine, action.operation, self.engine)
        except RorgError as failed:
            outcome = failure(action, failed)
        self.log.append((self.now, str(action) + (f" failed: {outcome.error}" if outcome.error else "")))
        if life == self.life:
            self.memory = finish(self.memory, [outcome], self.now)
        if not outcome.error:
            self._done(action)

    def _done(self, action: Action) -> None:
        """Applies the effects of a completed call."""
        if isinstance(action.operation, Start):
            container = self.engine.containers[action.container]
            after = 0.5 if container.digest in self.faults.bad else self.faults.crash_after.get(action.service)
            if after is not None:
                self.at(self.now + after, lambda: self._crash(container.id, container.incarnation))

    def _crash(self, container: str, run: str) -> None:
        observed = self.engine.containers.get(container)
        if observed and observed.alive and observed.incarnation == run:
            self.engine.kill(container, self.faults.exit_code)

    def inputs(self) -> Inputs:
        """What a pass would read now."""
        if not self.faults.unreachable:
            self._seen, self._found = tuple(self.engine.list()), self.engine.find_objects(self.desired.keys)
        unanswered = "the engine does not answer" if self.faults.unreachable else ""
        observed = Observed(self._seen, not self.faults.unreachable, unanswered, self._found, LookedAt(self.now))
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
            limits=DispatchLimits().allowing(self.desired.catalog.policy.bulk_workers),
            holds=self.document.holds,
            suspended=self.document.suspended,
            wall=self.wall,
            boot=self.boot,
            load=self._load(),
            renewals=self.renewals,
            confirmed=self.document.removals,
            retries=self.document.retries,
            cache=self.cache,
            ros=self.ros,
            devices={
                d: self.engine.devices[d.identity] for d in self.desired.devices if d.identity in self.engine.devices
            },
        )

    def _findings(self) -> Mapping[tuple[str, str], ProbeResult]:
        """Answers to the probes that the last pass wanted."""
        answers = {}
        for (name, role), target in self._asked.items():
            step = self.memory.of(name)
            if role == "interlock":
                ok = name not in self.locked
                answers[name, role] = ProbeResult("", ok, self.now, "" if ok else "not allowed")
            elif role == ROLE:
                answers[name, role] = ProbeResult(target.incarnation, True, self.now)
            elif step.running_since is not None and step.incarnation == target.incarnation:
                late = self.now - step.running_since < self.ready_after.get(name, PROBE_AFTER)
                deaf = any(str(question) in self.deaf for question in target.probe.questions)
                ok = step.incarnation not in self.hung and not deaf and not (role == "ready" and late)
                answers[name, role] = ProbeResult(
                    step.incarnation, ok, self.now, "" if ok else "no answer", 0 if ok else 1000, target.probe
                )
        return answers

    def _seconds_to_next_probe(self) -> float:
        """Seconds until the next pass because of probes. It is soon, unless every answer is the same as in the last
        pass and only an event can change it. A service that is not ready yet becomes ready just by time."""
        answers = self._findings()
        steady = all(
            (answer := answers.get(key)) is not None
            and (answer.ok or key[1] != "ready")
            and (told := self._told.get(key)) is not None
            and (told.incarnation, told.ok) == (answer.incarnation, answer.ok)
            and told.at >= (target.asked or 0.0)
            for key, target in self._asked.items()
        )
        return min(target.every for target in self._asked.values()) if steady else OFTEN

    def _load(self) -> Load | None:
        """The machine's load: everything that runs uses what it declares, plus `extra`."""
        limits = self.desired.catalog.policy.pressure
        if limits is None:
            return None
        if self._sample is None or self.now >= self._sample.at + limits.step:
            use = self._use()
            cores, memory = (sum(u[0] for u in use.values()), sum(u[1] for u in use.values()))
            self._sample = Load(self.now, self.extra[0] + cores, CORES, self.extra[1] + memory, MEMORY, use=use)
        return self._sample

    def _use(self) -> dict[str, tuple[float, int]]:
        """Service -> cores and bytes in use."""
        services = self.desired.catalog.services
        return {
            c.service: (services[c.service].cpu if c.state == "running" else 0.0, services[c.service].memory)
            for c in self.engine.list()
            if c.alive and c.service in services
        }

    def run(self, until: Callable[[SimRobot], bool], limit: float = 600.0) -> Decision:
        """Runs until the condition holds after a pass. Raises AssertionError after `limit` seconds."""
        end = self.now + limit
        while True:
            decision = self.step()
            if until(self):
                return decision
            times = [self._events[0][0]] if self._events else []
            times += [decision.deadline] if decision.deadline is not None else []
            times += [self.now + self._seconds_to_next_probe()] if decision.to_probe else []
            times += [self.now + OFTEN] if decision.to_look else []
            limits = self.desired.catalog.policy.pressure
            times += [self.now + limits.step] if limits else []
            if not times or min(times) > end:
                raise AssertionError(f"not so after {limit} s of virtual time:\n{decision.plan.text()}")
            self.now = max(self.now, min(times))
            self._happen()

    def _happen(self) -> None:
        """Runs the events that are due."""
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
        return {name: own[0].state for name, own in Observed(tuple(self.engine.list())).by_service().items()}

    def active(self) -> set[str]:
        return {c.service for c in self.engine.list() if c.state == "running"}
