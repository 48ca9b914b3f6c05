"""Simulates a trace: the loop's pass in virtual time, over programs that behave as a workload says."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Mapping
from functools import partial
from math import inf

from rorg.core.decide import Decision
from rorg.core.observed import Container
from rorg.core.pressure import pressed
from rorg.core.requests import problems
from rorg.core.wanted import wanted
from rorg.model.catalog import DEVELOPER, Catalog, Request
from rorg.model.graph import closure, conflicting, overbooked
from rorg.model.load import Load
from rorg.model.trace import Trace, TraceEvent
from rorg.model.workload import Workload
from rorg.tools.sim.programs import Programs
from rorg.tools.sim.results import Responses, RunResult
from rorg.tools.sim.robot import CORES, MEMORY
from rorg.tools.sim.robot_of_programs import RobotOfPrograms

ALL_ON = "all-on"
"""Id of the request for everything."""


def all_on_services(catalog: Catalog, trace: Trace) -> tuple[str, ...]:
    """Services that run when everything does. If some must not run together (conflicts, exclusive resources), those
    that the trace uses come first, and then the earlier names."""
    asked = (member for event in trace.events for name in event.services for member in catalog.members(name))
    used = closure(catalog.services, [*asked, *(n for n, s in catalog.services.items() if s.always_on)])
    names: set[str] = set()
    for name in sorted((n for n, s in catalog.services.items() if not s.meta), key=lambda n: (n not in used, n)):
        more = names | closure(catalog.services, [name])
        if not conflicting(catalog.services, more) and not overbooked(catalog, more):
            names = more
    return tuple(sorted(n for n in names if not catalog.services[n].meta))


def everything(catalog: Catalog, trace: Trace) -> Request:
    """The request that keeps all of them active."""
    return Request(ALL_ON, DEVELOPER, all_on_services(catalog, trace), "everything runs, for comparison")


def simulate(
    catalog: Catalog,
    trace: Trace,
    workload: Workload,
    seed: int,
    *,
    name: str = "rorg",
    all_on: bool = False,
    every: float = 1.0,
    cores: float | None = None,
) -> RunResult:
    """Runs the trace on a robot whose programs behave as the workload says, on a machine on which nothing runs yet.

    The same arguments give exactly the same result. `all_on`: for comparison, everything runs all the time; the trace
    then only requests services that could not run together with the rest. `every`: seconds between two samples; sums
    do not depend on it. `cores`: of the machine. While programs want more, each gets its share, and comes up more
    slowly; None: there are always enough.

    As in reality, a service makes its requests in its current run. They wait until it is ready, and a run that
    replaces a crashed one repeats the last requests that the trace made in its name. The time until a request is ready
    counts from its time in the trace. A program is in use while the trace wants it, even if everything runs.
    """
    run = _Run(catalog, trace, Programs(catalog.services, workload, seed), every, cores)
    if all_on:
        run.turn_on(everything(catalog, trace))
    run.play()
    return RunResult(
        name,
        trace.duration,
        tuple(run.use.samples),
        tuple(run.responses.found),
        tuple(run.violations.found),
        dict(sorted(Counter(verb for _, verb, _ in run.engine.calls).items())),
        run.use.cpu_seconds,
        run.use.byte_seconds,
        run.use.shortage if cores is not None else None,
    )


class _Run(RobotOfPrograms):
    """A robot that receives the requests of a trace."""

    def __init__(self, catalog: Catalog, trace: Trace, programs: Programs, every: float, cores: float | None) -> None:
        super().__init__(catalog, programs, every, cores)
        self.trace = trace
        self.responses = Responses(catalog)
        self._standing: dict[tuple[str, str], TraceEvent] = {}
        """Requests of the trace that are not released."""
        self._unmade: set[tuple[str, str]] = set()
        """Standing requests whose requester is not ready yet."""
        self._on: frozenset[str] = frozenset()
        """Services that are always requested."""
        self._sample_at = inf
        self._mattered = False
        for event in trace.events:
            self.at(event.at, partial(self._ask, event))
        if catalog.policy.pressure:
            self._sample_at, self._sample = 0.0, None

    def turn_on(self, request: Request) -> None:
        """Requests services for the whole trace."""
        self.document = self.document.put(request)
        self._on = frozenset(m for name in request.services for m in self.desired.catalog.members(name))

    # -- time --------------------------------------------------------------------------------------------------

    def play(self) -> None:
        """Plays the trace to its end."""
        self.step()
        self._want()
        self._happen()
        while True:
            decision = self.step()
            self.violations.look(decision, self.now)
            if self._made():
                continue
            self._look()
            if not self._go_on(decision):
                return

    def _go_on(self, decision: Decision) -> bool:
        """Moves on until a pass is needed; False at the end of the trace."""
        asked = self._asked_next()
        deadline = inf if decision.deadline is None else decision.deadline
        while True:
            event = self._events[0][0] if self._events else inf
            look = self._looks[0] if self._looks else inf
            worth = min(event, asked, deadline)
            now = min(worth, look, self._sample_at)
            self.use.advance(min(now, self.trace.duration))
            if now > self.trace.duration:
                self.use.sample()
                return False
            self.now = max(self.now, now)
            self._happen()
            loaded = now == self._sample_at and self._sampled()
            if now == worth or loaded or self._made():
                return True
            self._look()

    def _happen(self) -> None:
        super()._happen()
        self._account()

    # -- requests ----------------------------------------------------------------------------------------------

    def _ask(self, event: TraceEvent) -> None:
        key = event.requester, event.id
        self.responses.asked(event)
        self._unmade.discard(key)
        self._standing.pop(key, None)
        if event.services:
            self._standing[key] = event
        if event.services and self._needs_request(event):
            self._unmade.add(key)
        else:
            self.document = self.document.without({key})
        self._want()
        self._made()

    def _want(self) -> None:
        """Updates what the trace wants, by the rule of activation."""
        catalog = self.desired.catalog
        asked = [Request(e.id, e.requester, e.services) for e in self._standing.values()]
        self.in_use = frozenset(wanted(catalog, [*catalog.requests, *asked]))
        self.violations.wants(self.in_use)
        self._accounted = ()

    def _made(self) -> bool:
        """Makes the requests whose requesters are ready; whether there were any."""
        held = {r.key for r in self.document.requests}
        self._unmade |= {key for key, event in self._standing.items() if key not in held and self._needs_request(event)}
        made = False
        for key in sorted(self._unmade, key=list(self._standing).index):
            event = self._standing[key]
            run = self._run_of(event.requester)
            if run == "":
                continue
            self._unmade.discard(key)
            request = Request(event.id, event.requester, event.services, event.state, incarnation=run)
            reasons = problems(self.desired.catalog, self.document.requests, request)
            if reasons:
                self.violations.refused(self.now, event.requester, reasons)
                del self._standing[key]
                self.document = self.document.without({key})
                self._want()
            else:
                self.document = self.document.put(request)
            made = True
        return made

    def _needs_request(self, event: TraceEvent) -> bool:
        """Whether an event names a service that is not requested anyway."""
        return any(m not in self._on for name in event.services for m in self.desired.catalog.members(name))

    def _run_of(self, requester: str) -> str | None:
        """The run that makes a request now; "" if there is none yet, None if the requester has no runs."""
        service = self.desired.catalog.services.get(requester)
        if service is None or service.meta:
            return None
        return self.memory.of(requester).incarnation if self._ready(requester) else ""

    def _look(self) -> None:
        while self._looks and self._looks[0] <= self.now:
            heapq.heappop(self._looks)
        self.responses.look(self._ready, self.now)

    def _ready(self, service: str) -> bool:
        """Whether rorg considers a service ready, and its program is up."""
        step = self.memory.of(service)
        container = next(iter(self._observed().get(service, ())), None)
        if container is None:
            return False
        if container.state == "exited":
            return container.exit_code == 0 and step.over(self.desired.catalog.services[service], container)
        if service in self.memory.in_flight:  # it may be stopped just now
            return False
        return step.ready and container.state == "running" and self._up.get(container.id, inf) <= self.now

    def _observed(self) -> Mapping[str, list[Container]]:
        return self.decision.situation.observed.by_service()

    # -- the machine -------------------------------------------------------------------------------------------

    def _load(self) -> Load | None:
        return self._sample

    def _sampled(self) -> bool:
        """Samples the machine; whether that needs a pass, by the rule of the daemon's loop."""
        policy = self.desired.catalog.policy
        if policy.pressure is None:
            return False
        use = self.use.by_service() if self._mattered else {}
        self._sample = Load(self.now, self.use.cores, self.use.limit or CORES, int(self.use.memory), MEMORY, use=use)
        self._sample_at = self.now + policy.pressure.step
        matters = self.memory.pressure.engaged or bool(pressed(policy.pressure, policy.budget, self._sample))
        worth, self._mattered = matters or self._mattered, matters
        return worth
