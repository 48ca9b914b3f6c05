"""Plays a trace on a running robot: makes its requests at their times, and measures the result."""

from __future__ import annotations

import os
import threading
import time
from collections import Counter, deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace

from rorg.core.decide import Decision
from rorg.core.wanted import wanted
from rorg.daemon.loop import Loop
from rorg.history.journal import ALL, Filter
from rorg.model.catalog import Request
from rorg.model.trace import Trace, TraceEvent
from rorg.tools.sim.meters import OwnMeter, ServicesMeter
from rorg.tools.sim.results import Responses, RunResult, Sample, Violations
from rorg.tools.sim.throwaway import ThrowawayRobot
from rorg.tools.sim.validity import Conditions, Flaw, flaws

LOOK, LOOKS = 0.25, 4
"""Seconds between two looks at the services' use; looks for each sample."""
AGAIN = 0.02
"""Seconds until rorg tries a request again if its requester was not ready."""


@dataclass(frozen=True, slots=True)
class EmulatedRun:
    """The measurements of one run."""

    result: RunResult
    own_cpu: float
    """Mean number of cores that rorg itself used."""
    own_memory: int
    """Largest number of bytes in use by its process, including the measurements."""
    load: tuple[float, float]
    """The machine's load average over one minute, before and after."""
    measured: Mapping[tuple[str, str], tuple[float, ...]]
    """Seconds of calls of the engine, and until services were ready, in the form of a Workload."""
    made: tuple[TraceEvent, ...]
    """The events of the trace, each with the time at which it was passed on."""
    conditions: Conditions

    @property
    def flaws(self) -> tuple[Flaw, ...]:
        """Why it is not valid."""
        return flaws(self.conditions, self.result.responses)

    @property
    def calls(self) -> dict[str, tuple[float, ...]]:
        """Verb -> seconds of each call of the engine."""
        by_verb: dict[str, tuple[float, ...]] = {}
        for (verb, _), seconds in sorted(self.measured.items()):
            if verb not in ("up", "again"):
                by_verb[verb] = (*by_verb.get(verb, ()), *seconds)
        return by_verb


@dataclass
class Readiness:
    """Measures how long services with a probe took to become ready. Only starts after `since` count (monotonic
    seconds)."""

    since: float
    found: dict[tuple[str, str], list[float]] = field(default_factory=dict)
    """(up after a start, again after a resume; service) -> seconds."""
    _seen: dict[str, tuple[str, float]] = field(default_factory=dict)
    """Service -> the run that was last ready, and since when it ran."""

    def look(self, decision: Decision) -> None:
        """Called after every pass."""
        for name, service in decision.situation.desired.catalog.services.items():
            step = decision.memory.of(name)
            if service.ready is None or service.ready.delay is not None:
                continue
            if not step.ready or step.running_since is None:
                continue
            known, now = self._seen.get(name), (step.incarnation, step.running_since)
            self._seen[name] = now
            if known != now and step.running_since >= self.since:
                after = "again" if known and known[0] == now[0] else "up"
                self.found.setdefault((after, name), []).append(decision.situation.now - step.running_since)


class Player:
    """Plays one trace on a settled robot. Time 0 is the call of play()."""

    def __init__(self, robot: ThrowawayRobot, loop: Loop, trace: Trace) -> None:
        catalog = loop.tree.desired.catalog
        self.robot, self.loop, self.trace, self.catalog = robot, loop, trace, catalog
        self.responses, self.violations = Responses(catalog), Violations(None)
        self.readiness = Readiness(time.monotonic())
        self.meter = ServicesMeter(robot.engine.usage, {name: one.cpu for name, one in catalog.services.items()})
        self._standing: dict[tuple[str, str], TraceEvent] = {}
        """Requests of the trace that are not released."""
        self._unmade: dict[tuple[str, str], TraceEvent] = {}
        """Standing requests whose requester is not ready yet."""
        self._passed: list[TraceEvent] = []
        self._samples: list[Sample] = []
        self._cpu_before = 0.0
        """CPU seconds at the last sample."""
        self._began = 0.0
        self._lock = threading.Lock()
        """Guards `responses` and `violations`: one thread makes requests, the loop's thread sees that they are
        ready."""

    @property
    def now(self) -> float:
        """Seconds since the trace began."""
        return time.monotonic() - self._began

    def play(self, name: str) -> EmulatedRun:
        """Plays the trace to its end. `name`: of the result."""
        seq, load, memory = self.loop.recorder.journal.last, os.getloadavg()[0], 0
        self.meter.look(self.robot.containers())
        own, self._began = OwnMeter(), time.monotonic()
        self._want()
        self.loop.decided = self._decided
        for _ in self._moments():
            memory = max(memory, own.memory())
        self.loop.decided = lambda: None
        other = own.other_cores(self.meter.cpu_seconds)
        conditions = Conditions(os.cpu_count() or 1, other, self.meter.stand_ins)
        calls = self._calls(seq)
        measured = {key: tuple(seconds) for key, seconds in (calls | self.readiness.found).items()}
        actions = Counter(verb for (verb, _), seconds in calls.items() for _ in seconds)
        result = RunResult(
            name,
            self.trace.duration,
            tuple(self._samples),
            tuple(self.responses.found),
            tuple(self.violations.found),
            dict(sorted(actions.items())),
            cpu_seconds=self.meter.cpu_seconds,
        )
        loads, made = (load, os.getloadavg()[0]), tuple(self._passed)
        return EmulatedRun(result, own.cores(), memory, loads, measured, made, conditions)

    # -- time --------------------------------------------------------------------------------------------------

    def _moments(self) -> Iterator[None]:
        """Does everything at its time, and yields once for each sample."""
        events, looks = deque(self.trace.events), 1
        while True:
            event = events[0].at if events else self.trace.duration + 1
            until = min(event, looks * LOOK)
            if until > self.trace.duration:
                self._sleep(self.trace.duration)
                return
            self._sleep(until)
            if until == event:
                self._ask(events.popleft())
                continue
            self.meter.look(self.robot.containers())
            if looks % LOOKS == 0:
                self._sample()
                yield
            looks += 1

    def _sleep(self, until: float) -> None:
        """Sleeps, and makes requests as soon as their requesters are ready."""
        while (left := until - self.now) > 0:
            time.sleep(min(left, AGAIN) if self._unmade else left)
            self._make()

    def _sample(self) -> None:
        containers, now = self.robot.containers(), self.now
        before = self._samples[-1].at if self._samples else 0.0
        cpu = self.meter.cpu_seconds - self._cpu_before
        self._cpu_before = self.meter.cpu_seconds
        active, paused = (frozenset(c.service for c in containers if c.state == s) for s in ("running", "paused"))
        self._samples.append(Sample(now, cpu / (now - before), self.meter.memory, active, paused - active))

    # -- requests ----------------------------------------------------------------------------------------------

    def _ask(self, event: TraceEvent) -> None:
        key = event.requester, event.id
        with self._lock:
            self.responses.asked(event)
        self._unmade.pop(key, None)
        self._standing.pop(key, None)
        if event.services:
            self._standing[key] = self._unmade[key] = event
        self._want()
        if event.services:
            self._make()
        else:
            self.robot.requests.change(lambda asked: asked.without({key}))
        self._passed.append(replace(event, at=self.now))

    def _want(self) -> None:
        """Updates what the trace wants, by the rule of activation."""
        asked = [Request(e.id, e.requester, e.services) for e in self._standing.values()]
        with self._lock:
            self.violations.wants(frozenset(wanted(self.catalog, [*self.catalog.requests, *asked])))

    def _make(self) -> None:
        """Makes the requests whose requesters are ready."""
        for key, event in list(self._unmade.items()):
            run = self._run_of(event.requester)
            if run != "":
                del self._unmade[key]
                request = Request(event.id, event.requester, event.services, event.state, incarnation=run)
                self.robot.requests.change(lambda asked, request=request: asked.put(request))  # type: ignore[misc]

    def _run_of(self, requester: str) -> str | None:
        """The run that makes a request now; "" if there is none yet, None if the requester has no runs."""
        service = self.catalog.services.get(requester)
        if service is None or service.meta:
            return None
        return self.loop.running.memory.of(requester).incarnation if self._ready(requester) else ""

    # -- called by the loop, in its thread ---------------------------------------------------------------------

    def _decided(self) -> None:
        decision = self.loop.decision
        if decision is not None:
            self.readiness.look(decision)
            with self._lock:
                self.responses.look(self._ready, self.now)
                self.violations.look(decision, self.now)

    def _ready(self, service: str) -> bool:
        decision = self.loop.decision
        if decision is None:
            return False
        memory, containers = decision.memory, decision.situation.observed.of(service)
        if any(c.state == "exited" and memory.of(service).over(self.catalog.services[service], c) for c in containers):
            return True
        running = any(c.state == "running" for c in containers)
        return running and memory.of(service).ready and service not in memory.in_flight

    def _calls(self, seq: int) -> dict[tuple[str, str], list[float]]:
        """(verb, service) -> seconds of each call of the engine after this entry of the journal."""
        durations: dict[tuple[str, str], list[float]] = {}
        for entry in self.loop.recorder.journal.select(Filter(kinds=frozenset({"done"}), after=seq), ALL):
            durations.setdefault((entry["verb"], entry["service"]), []).append(entry["seconds"])
        return durations
