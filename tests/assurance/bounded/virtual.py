"""A robot in virtual time that can be copied at any moment, whose engine may lie and whose view may be old."""

from __future__ import annotations

import heapq
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial

from bounded.watch import Reader, WatchedEngine

from rorg.core.dispatch import Outcome, finish
from rorg.core.memory import ProbeResult
from rorg.core.observed import Container
from rorg.core.operations import Start
from rorg.core.plan import Action
from rorg.engines.execute import failure, perform
from rorg.errors import EngineError, RorgError, Unreachable
from rorg.model.catalog import Catalog
from rorg.tools.sim.robot import OFTEN

LATE = 10.0
"""Seconds after which a late answer comes."""
CALLS = ("fail", "did", "late", "lost", "hang")
"""What may become of a call: it fails; it is done but answers an error; it is done but answers late; it is done but
only times out; it is done late."""


class Ids:
    """Ids of containers, each different in its first digits as those of Docker are."""

    def __init__(self, last: int = 0) -> None:
        self.last = last

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        self.last += 1
        return f"{self.last:012x}" + "0" * 52


class WorldRobot(Reader):
    """`spoilt` says what becomes of the next call on a service, `unseen` until when changes of one go unseen."""

    def __init__(self, catalog: Catalog) -> None:
        super().__init__(catalog)
        self.engine._ids = Ids()
        self.number, self.acknowledged = 0, set()
        self.spoilt: dict[str, str] = {}
        self.modes: dict[tuple[int, str], str] = {}
        """(life, service) -> what becomes of the call under way."""
        self.unseen: dict[str, float] = {}
        self.view: dict[str, tuple[Container, ...]] = {}
        """Service whose changes go unseen -> its containers as seen last."""
        self.doubled = 0.0
        """Until when each event is delivered twice."""

    def at(self, time: float, do: partial) -> None:
        """Only partial(self.method, ...) can be copied."""
        self.number += 1
        heapq.heappush(self._events, (time, self.number, do))

    def fork(self) -> WorldRobot:
        """Return a copy that goes its own way."""
        other = WorldRobot.__new__(WorldRobot)
        other.__dict__.update(self.__dict__)
        for name in ("hung", "locked", "spoilt", "modes", "unseen", "view", "ready_after", "acknowledged"):
            setattr(other, name, getattr(self, name).copy())
        faults = {k: v.copy() if isinstance(v, (dict, set)) else v for k, v in vars(self.faults).items()}
        other.faults = replace(self.faults, **faults)
        other.log = []
        engine = other.engine = WatchedEngine.__new__(WatchedEngine)
        engine.__dict__.update(self.engine.__dict__)
        for name in ("containers", "calls", "objects", "_output", "_run_from", "_joined", "_ran"):
            setattr(engine, name, getattr(self.engine, name).copy())
        engine._ids, engine.faults = Ids(self.engine._ids.last), other.faults
        engine.clock, engine.wall = lambda: other.now, lambda: other.now + other.clock_set
        other._events = [(t, n, partial(getattr(other, do.func.__name__), *do.args)) for t, n, do in self._events]
        return other

    # -- a call that lies ------------------------------------------------------------------------------------------

    def _latency(self, action: Action) -> float:
        mode = self.spoilt.pop(action.service, "")
        self.modes[self.life, action.service] = mode
        return super()._latency(action) + (LATE if mode == "hang" else 0.0)

    def _finish(self, action: Action, life: int) -> None:
        mode, outcome = self.modes.pop((life, action.service), ""), Outcome(action)
        self.engine.by_rorg = True
        try:
            if self.faults.unreachable:
                raise Unreachable("call the engine", "it does not answer")
            if mode == "fail":
                self._refuse(action)
                raise EngineError(f"{action.verb} {action.service}", "no space left on the device")
            perform(self.engine, action.operation, self.engine)
        except RorgError as failed:
            outcome = failure(action, failed)
        finally:
            self.engine.by_rorg = False
        if not outcome.error:
            self._done(action)
        if mode in ("did", "lost") and not outcome.error:
            outcome = failure(action, Unreachable(f"{action.verb} {action.service}", "no answer in time"))
        if mode in ("late", "lost"):
            self.at(self.now + LATE, partial(self._answer, outcome, life))
        else:
            self._answer(outcome, life)

    def _refuse(self, action: Action) -> None:
        """Remember whose start the engine refused."""
        if isinstance(action.operation, Start) and (one := self.engine.containers.get(action.container)):
            self.refused = self.refused | {one.digest}

    def _answer(self, outcome: Outcome, life: int) -> None:
        """The answer of a call arrives. As a worker does, it looks at the container first."""
        if life != self.life:
            return
        self._look_at(outcome.action.service)
        self.memory = finish(self.memory, [outcome], self.now)

    def _done(self, action: Action) -> None:
        if isinstance(action.operation, Start):
            container = self.engine.containers[action.container]
            if container.digest in self.faults.bad:
                self.at(self.now + 0.5, partial(self._crash, container.id, container.incarnation))

    # -- a view that is old ----------------------------------------------------------------------------------------

    def lags(self, service: str) -> bool:
        return service in self.view or self.faults.unreachable

    def unsee(self, service: str, seconds: float) -> None:
        """Changes of a service go unseen for so long, unless rorg looks itself."""
        self.unseen[service] = self.now + seconds
        if service not in self.view:
            self.view[service] = tuple(c for c in self.engine.containers.values() if c.service == service)
        self.at(self.now + seconds, partial(self._nothing))

    def _look_at(self, service: str) -> None:
        if service in self.view:
            self.view[service] = tuple(c for c in self.engine.containers.values() if c.service == service)

    def visible(self, present: tuple[Container, ...], asked: Mapping[str, float]) -> tuple[Container, ...]:
        for service in [n for n, until in self.unseen.items() if until <= self.now and not self.faults.unreachable]:
            del self.unseen[service], self.view[service]
        if not self.view or self.faults.unreachable:
            return present
        for service in self.view:
            if any(c.id in asked for c in self.view[service]):
                self._look_at(service)
        seen = [c for c in present if c.service not in self.view]
        return (*seen, *(c for view in self.view.values() for c in view))

    def _findings(self) -> Mapping[tuple[str, str], ProbeResult]:
        """Only what runs answers a probe, whatever rorg sees of it."""
        running = {c.incarnation for c in self.engine.containers.values() if c.state == "running"}
        return {
            key: said
            if said.incarnation in running or key[1] == "interlock"
            else replace(said, ok=False, failures=1000, message="no answer")
            for key, said in super()._findings().items()
        }

    def _seconds_to_next_probe(self) -> float:
        """What is frozen, and what is asked where nothing answers, gives no other answer however often it is asked."""
        seconds = super()._seconds_to_next_probe()
        return max(seconds, 2.0) if self.hung or self.bad_probes else seconds

    # -- time ------------------------------------------------------------------------------------------------------

    def _nothing(self) -> None:
        """Something to wake up for."""

    def thaw(self) -> None:
        """The engine answers again."""
        self.faults.unreachable = False

    def pass_until(self, time: float, passed: partial) -> int:
        """Run until a pass at this time, and return how many passes that took. `passed` is called after each."""
        self.at(time, partial(self._nothing))
        passes = 0
        while True:
            for _ in range(2 if self.now < self.doubled else 1):
                decision = self.step()
                passed()
                passes += 1
            if self.now >= time:
                return passes
            times = [self._events[0][0]]
            times += [decision.deadline] if decision.deadline is not None else []
            times += [self.now + self._seconds_to_next_probe()] if decision.to_probe else []
            times += [self.now + OFTEN] if decision.to_look else []
            self.now = max(self.now, min(times))
            self._happen()
