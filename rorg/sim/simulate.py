"""A trace on a simulated robot: the pass of the loop in virtual time, over programs that behave as a workload says."""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Mapping
from functools import partial
from math import ceil, inf

from rorg.core.changes import changed_items
from rorg.core.decide import Decision
from rorg.core.memory import ProbeResult
from rorg.core.observed import Container
from rorg.core.plan import Action
from rorg.core.pressure import Load, pressed
from rorg.core.requests import problems
from rorg.core.wanted import wanted
from rorg.model.catalog import Catalog, Request
from rorg.model.learned import Learned
from rorg.model.trace import Trace, TraceEvent
from rorg.model.workload import Workload
from rorg.sim.baseline import everything
from rorg.sim.programs import Programs
from rorg.sim.responses import Responses
from rorg.sim.results import RunResult
from rorg.sim.robot import CORES, MEMORY, SimRobot
from rorg.sim.use import MachineUse, Use
from rorg.sim.violations import Violations

ANSWER = 0.002
"""Seconds that a probe takes to be answered."""


def simulate(
    catalog: Catalog,
    trace: Trace,
    workload: Workload,
    seed: int,
    *,
    name: str = "rorg",
    all_on: bool = False,
    every: float = 1.0,
    learned: Learned | None = None,
) -> RunResult:
    """Runs the trace on a robot whose programs behave as the workload says, from a machine on which nothing runs.

    The same arguments give the same result, bit for bit. `all_on`: everything runs all the time, for comparison.
    `every`: seconds between two samples; sums do not depend on it. `learned`: what is known of requests when it begins,
    for services that are prewarmed; it goes on learning. None: none are.

    A requester that is a service requests by its run of then, as in reality: while it is not ready its requests wait,
    and a run that takes the place of one that crashed makes anew what the trace last asked in its name. The time until
    a request is ready counts from its time in the trace. What a program uses while it is wanted or not goes by what
    the trace wants, also where everything runs. Use adds up: nothing gets slower when more is asked of a machine than
    it has.
    """
    run = _Run(catalog, trace, Programs(catalog.services, workload, seed), every)
    run.learned = learned
    if all_on:
        run.document = run.document.put(everything(catalog, trace))
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
    )


class _Run(SimRobot):
    """A robot whose programs take their time, use the machine and crash."""

    def __init__(self, catalog: Catalog, trace: Trace, programs: Programs, every: float) -> None:
        super().__init__(catalog)
        self.trace, self.programs = trace, programs
        self.use = MachineUse(every)
        self.responses, self.violations = Responses(catalog), Violations(catalog.policy.budget)
        self.in_use: frozenset[str] = frozenset()
        """What the trace wants now."""
        self._standing: dict[tuple[str, str], TraceEvent] = {}
        """Requests of the trace that are not released."""
        self._unmade: set[tuple[str, str]] = set()
        """Those of them that wait for their requester."""
        self._up: dict[str, float] = {}
        """Container -> when its program does what it is for; while it is paused, seconds that it still needs."""
        self._began: dict[str, float] = {}
        """Container -> when it was last started or resumed."""
        self._life: dict[str, float] = {}
        """Container -> when it crashes; while it is paused, seconds that are left."""
        self._looks: list[float] = []
        """When programs come up, which is nothing to the loop."""
        self._accounted: tuple[Container, ...] = ()
        self._sample_at = inf
        self._mattered = False
        for event in trace.events:
            self.at(event.at, partial(self._ask, event))
        if catalog.policy.pressure:
            self._sample_at, self._sample = 0.0, None

    # -- time --------------------------------------------------------------------------------------------------

    def play(self) -> None:
        """To the end of the trace."""
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
        """Until something is worth a pass; False at the end."""
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

    def _asked_next(self) -> float:
        """When a probe tells something new."""
        times = [inf]
        for (name, role), target in self._asked.items():
            told = self._told.get((name, role))
            if role == "interlock" and told is None:
                times.append(self.now + ANSWER)
            elif role == "ready" and not (told and told.ok and told.incarnation == target.incarnation):
                times.append(max(self._answers_at(target.container, target.every), self.now + ANSWER))
        return min(times)

    def _answers_at(self, container: Container | None, every: float) -> float:
        """When the first probe of a run is made that it answers."""
        if container is None or container.state != "running":
            return inf
        began, up = self._began[container.id], self._up[container.id]
        return began + ceil(max(0.0, up - began) / every - 1e-9) * every

    def _findings(self) -> Mapping[tuple[str, str], ProbeResult]:
        found = {}
        for key, target in self._asked.items():
            step, told = self.memory.of(key[0]), self._told.get(key)
            since = step.running_since
            if key[1] == "interlock":
                found[key] = ProbeResult("", True, self.now)
            elif since is None or step.incarnation != target.incarnation:
                continue
            elif told and told.ok and told.incarnation == step.incarnation and told.at >= since:
                found[key] = told
            else:
                ok = key[1] == "live" or self.now >= self._answers_at(target.container, target.every)
                found[key] = ProbeResult(step.incarnation, ok, self.now, "" if ok else "no answer", 0 if ok else 1)
        return found

    # -- requests ----------------------------------------------------------------------------------------------

    def _ask(self, event: TraceEvent) -> None:
        key = event.requester, event.id
        self.responses.asked(event)
        self._unmade.discard(key)
        self._standing.pop(key, None)
        if event.services:
            self._standing[key] = event
            self._unmade.add(key)
        else:
            self.document = self.document.without({key})
        self._want()
        self._made()

    def _want(self) -> None:
        """What the trace wants, by the rule of activation."""
        catalog = self.desired.catalog
        asked = [Request(e.id, e.requester, e.services) for e in self._standing.values()]
        self.in_use = frozenset(wanted(catalog, [*catalog.requests, *asked]))
        self.violations.wants(self.in_use)
        self._accounted = ()

    def _made(self) -> bool:
        """Makes the requests whose requesters are there; whether there were any."""
        held = {r.key for r in self.document.requests}
        self._unmade |= {key for key in self._standing if key not in held}
        made = False
        for key in sorted(self._unmade, key=list(self._standing).index):
            event = self._standing[key]
            run = self._run_of(event.requester)
            if run == "":
                continue
            self._unmade.discard(key)
            request = Request(event.id, event.requester, event.services, event.state, incarnation=run)
            found = problems(self.desired.catalog, self.document.requests, request)
            if found:
                self.violations.refused(self.now, event.requester, found)
                del self._standing[key]
                self.document = self.document.without({key})
                self._want()
            else:
                self.document = self.document.put(request)
            made = True
        return made

    def _run_of(self, requester: str) -> str | None:
        """The run that requests now; "" while there is none, None for who has no runs."""
        service = self.desired.catalog.services.get(requester)
        if service is None or service.meta:
            return None
        return self.memory.of(requester).incarnation if self._ready(requester) else ""

    def _look(self) -> None:
        while self._looks and self._looks[0] <= self.now:
            heapq.heappop(self._looks)
        self.responses.look(self._ready, self.now)

    def _ready(self, service: str) -> bool:
        """rorg takes it for ready, and its program is."""
        step = self.memory.of(service)
        found = next(iter(self._observed().get(service, ())), None)
        if found is None:
            return False
        if found.state == "exited":
            return found.exit_code == 0 and step.over(self.desired.catalog.services[service], found)
        return step.ready and found.state == "running" and self._up.get(found.id, inf) <= self.now

    def _observed(self) -> Mapping[str, list[Container]]:
        return self.decision.situation.observed.by_service()

    # -- programs ----------------------------------------------------------------------------------------------

    def _check(self, decision: Decision) -> None:
        """What the plan violates is told with the rest."""

    def _latency(self, action: Action) -> float:
        return self.programs.call(action.verb, action.service)

    def _done(self, action: Action) -> None:
        container, now = action.container, self.now
        if action.verb == "start":
            self._begin(container, self.programs.start(action.service), self.programs.life(action.service))
        elif action.verb == "pause":
            self._up[container] = max(0.0, self._up[container] - now)
            self._life[container] -= now
        elif action.verb == "resume":
            up = max(self._up[container], self.programs.resume(action.service))
            self._begin(container, up, self._life[container])

    def _begin(self, container: str, up: float, life: float) -> None:
        """Its program runs from now on: it needs so long to come up, and lives so long."""
        self._began[container], self._up[container], self._life[container] = self.now, self.now + up, self.now + life
        heapq.heappush(self._looks, self._up[container])
        service = self.desired.catalog.services.get(self.engine.containers[container].service)
        if service and service.ready and service.ready.completed:
            self.at(self._up[container], lambda: self._end(container, self._up, 0))
        if life < inf:
            self.at(self._life[container], lambda: self._end(container, self._life, 1))

    def _end(self, container: str, times: Mapping[str, float], code: int) -> None:
        """It ends by itself, where it runs and its time is come: a pause has put that off."""
        found = self.engine.containers.get(container)
        if found and found.state == "running" and times[container] <= self.now:
            self.engine.kill(container, code)

    def _account(self) -> None:
        """What containers use has changed with what they do."""
        containers = tuple(self.engine.list())
        if not changed_items(self._accounted, containers):
            return
        for one in {c.id: c for c in changed_items(self._accounted, containers)}:
            self._account_for(one, self.engine.containers.get(one))
        self._accounted = containers
        self.violations.used(self.now, self.use.cores, self.use.memory)

    def _account_for(self, id: str, found: Container | None) -> None:
        before = self.use.of(id)
        if found is None or not found.alive:
            if before is not None:
                self.use.change(id, None)
            return
        in_use, running = found.service in self.in_use, found.state == "running"
        doing = (found.state, in_use, found.started_at)
        if before is not None and before.doing == doing:
            return
        cores = self.programs.cores(found.service, in_use) if running else 0.0
        memory = self.programs.memory(found.service, found.state, in_use)
        grown = before.grown(self.use.now) if before is not None and before.doing[2] == doing[2] else 0.0
        growth = self.programs.growth(found.service) if running else 0.0
        self.use.change(id, Use(found.service, doing, cores, memory, grown, growth, self.use.now))

    # -- the machine -------------------------------------------------------------------------------------------

    def _load(self) -> Load | None:
        return self._sample

    def _sampled(self) -> bool:
        """A sample of the machine; whether it is worth a pass, by the rule of the daemon's loop."""
        policy = self.desired.catalog.policy
        if policy.pressure is None:
            return False
        use = self.use.by_service() if self._mattered else {}
        self._sample = Load(self.now, self.use.cores, CORES, int(self.use.memory), MEMORY, use=use)
        self._sample_at = self.now + policy.pressure.step
        matters = self.memory.pressure.engaged or bool(pressed(policy.pressure, policy.budget, self._sample))
        worth, self._mattered = matters or self._mattered, matters
        return worth
