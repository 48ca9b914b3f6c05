"""Evidence about a robot in virtual time, gathered pass by pass and call by call. The invariants (invariants.py) judge
it; nothing here does."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

from rorg.core.inputs import Inputs
from rorg.core.joining import joined_of
from rorg.core.observed import Container
from rorg.core.operations import Stop
from rorg.core.plan import Action
from rorg.core.rollout import GOING
from rorg.core.situation import Situation
from rorg.core.trial import candidate
from rorg.daemon.snapshot import Snapshots
from rorg.model.catalog import Catalog, Request, Service
from rorg.model.graph import closure
from rorg.model.joining import ends_with
from rorg.tools.sim.engine import SimEngine
from rorg.tools.sim.robot import OFTEN, SimRobot

UNEVENTFUL = 4
"""One of so many passes that repeat the pass before is compared with one that keeps nothing."""
SPARING = 6
EXACT = 1e-6
"""Seconds of tolerance for times that were rounded."""


class WatchedEngine(SimEngine):
    """Tells `heard` about each call that rorg makes, just before it takes effect."""

    heard: Callable[[str, Container | None, str], None] | None = None
    """Gets the verb, the container (None if the call creates it), and the service."""
    strangers: frozenset[str] = frozenset()
    """Containers that do not belong to rorg."""
    by_rorg = False
    """Whether rorg makes the present call, rather than a person."""

    def _fault(self, verb: str, service: str) -> None:
        super()._fault(verb, service)
        if self.heard and self.by_rorg and verb == "create":
            self.heard(verb, None, service)

    def _change(self, verb: str, container: str, states: tuple[str, ...], **fields: object) -> None:
        before = self.containers.get(container)
        super()._change(verb, container, states, **fields)
        if self.heard and self.by_rorg and before:
            self.heard(verb, before, before.service)


class Reader(SimRobot):
    """Keeps what the last pass has read. Looks at a container only when it is new, or when a verdict asks for it."""

    looked: Mapping[str, float] = MappingProxyType({})
    acknowledged: set[tuple[str, str]] | None = None
    """Keys of the requests that were acknowledged and neither released nor dropped, if somebody keeps a list."""
    refused: frozenset[str] = frozenset()
    """Digests of containers that the engine did not start."""
    bad_files: frozenset[str] = frozenset()
    bad_probes: frozenset[str] = frozenset()
    """Services that mount a file with which their programs end."""
    patience = 0.0
    """Seconds between passes at least, while all probes say what they said before."""

    def __init__(self, catalog: Catalog, owner: str = "sim") -> None:
        super().__init__(catalog, owner)
        self.engine = WatchedEngine(owner, lambda: self.now, self.faults, lambda: self.now + self.clock_set)

    def inputs(self) -> Inputs:
        found, asked = super().inputs(), self.decision.to_look if self.cache else {}
        seen = self.visible(found.observed.containers, asked)
        new = {c.id: self.now for c in seen if c.id in asked or c.id not in self.looked}
        self.looked = {**self.looked, **new}
        self.read = replace(found, observed=replace(found.observed, containers=seen, looked=self.looked))
        return self.read

    def visible(self, present: tuple[Container, ...], asked: Mapping[str, float]) -> tuple[Container, ...]:
        """What it sees of the present containers. It looks now at those that are `asked` for."""
        return present

    def _seconds_to_next_probe(self) -> float:
        seconds = super()._seconds_to_next_probe()
        return seconds if seconds <= OFTEN else max(seconds, self.patience)

    def _finish(self, action: Action, life: int) -> None:
        self.engine.by_rorg = True
        try:
            super()._finish(action, life)
        finally:
            self.engine.by_rorg = False

    def lags(self, service: str) -> bool:
        """Whether what it sees of a service is older than the present."""
        return False


class Watch:
    """What happened to one robot so far. `passed` is called after each pass."""

    def __init__(self, robot: Reader, check: Callable[[str, Watch], None], sparing: bool = False) -> None:
        """`check` judges by all invariants of one moment: begin, call or pass. A `sparing` watch compares only one in
        SPARING passes with one that keeps nothing."""
        self.robot, self.check, self.sparing = robot, check, sparing
        robot.engine.heard = self._called
        self.shed: tuple = ()
        """Services that are shed, and those that were before this pass."""
        self.shed_before: tuple = ()
        self.ranks: Mapping[str, int] = {}
        """Effective priorities of the pass before. What is shed takes away those that it lent."""
        self.begun: set[tuple] = set()
        self.starts: dict[str, float] = {}
        """When the last call that started a service began."""
        self.unseen: dict[str, set[str]] = {}
        """Service -> services of which rorg saw the past when it began to start it last."""
        self.passes, self.snapshots = 0, Snapshots()
        self.repeated, self.before = 0, ()
        self.baked: dict[str, str] = {}
        """Service -> the edition that stayed well last, as of the pass before."""
        self.ready: dict[str, str] = {}
        """Service -> the incarnation that rorg called ready in the pass before."""
        self.good: set[str] = set()
        """Containers that stayed well for their bake, as all of their set did, and did not fail since."""
        self.well: set[str] = set()
        """The same, and those whose set is not complete yet."""
        self.tried: set[str] = set()
        """Digests of containers that have run."""
        self.leased: dict[tuple, float] = {}
        """Lease -> when it began at the latest."""
        self.life = 0
        """Which rorg decided the pass before."""
        self.unwanted: dict[str, float] = {}
        """Service -> since when it is not wanted."""
        self.quarantined: dict[tuple[str, str], float] = {}
        """(service, edition) that failed, and that nothing allows to try again -> when."""
        self.stopped: set[str] = set()
        self.to_stop: set[str] = set()
        """Runs that rorg stopped, and those that it began to stop."""
        self.action: tuple[str, Action] | None = None
        """The action that begins just now, with its service."""
        self.call: tuple[str, Container | None, str] | None = None
        """The call that the engine executes just now."""

    def fork(self, robot: Reader) -> Watch:
        """Return a watch with the same evidence on a copy of the robot."""
        other = Watch.__new__(Watch)
        other.__dict__.update(self.__dict__)
        for name in ("begun", "good", "well", "tried", "stopped", "to_stop"):
            setattr(other, name, {*getattr(self, name)})
        for name in ("starts", "unseen", "baked", "ready", "leased", "quarantined"):
            setattr(other, name, {**getattr(self, name)})
        other.robot, other.snapshots = robot, Snapshots()
        robot.engine.heard = other._called
        return other

    def passed(self) -> bool:
        """Gather what this pass shows, and check it. Return True."""
        self._note_repetition()
        self._note_good()
        self._note_leases()
        self._note_unwanted()
        self.shed_before, self.shed = self.shed, self.robot.memory.pressure.shed
        for name, flight in self.robot.memory.in_flight.items():
            if (name, flight.since) not in self.begun:
                self.begun.add((name, flight.since))
                self.action = name, flight.action
                self.check("begin", self)
                if isinstance(flight.action.operation, Stop):
                    self.to_stop.add(flight.action.operation.incarnation)
                if flight.action.verb == "start":
                    self.starts[name] = flight.since
                    self.unseen[name] = {other for other in self.services if self.robot.lags(other)}
        self.passes += 1
        self.check("pass", self)
        if self.robot.acknowledged is not None:
            self.robot.acknowledged -= {request.key for request, _ in self.robot.decision.settled.dropped}
        progress = self.robot.memory.progress
        self.baked = {name: step.update.baked for name, step in progress.items()}
        self.ready = {name: step.incarnation for name, step in progress.items() if step.ready}
        self.ranks = self.robot.decision.situation.priorities
        return True

    def _called(self, verb: str, container: Container | None, service: str) -> None:
        self.call = verb, container, service
        if verb == "stop" and container and container.incarnation in self.to_stop:
            self.stopped.add(container.incarnation)
        self.check("call", self)
        self.call = None

    def _note_repetition(self) -> None:
        decision = self.robot.decision
        waitings = [(w.service, w.until, w.code) for w in decision.plan.waitings]
        now = decision.plan.actions, waitings, decision.begin, self.robot.memory.in_flight, self.robot.read.observed
        self.repeated = self.repeated + 1 if now == self.before else 0
        self.before = now

    def _note_good(self) -> None:
        """A container is good once it has stayed well, until it ends on its own or hangs."""
        desired = self.robot.desired
        for container in self.robot.engine.containers.values():
            step = self.robot.memory.of(container.service)
            if container.started_at:
                self.tried.add(container.digest)
            if container.incarnation in (step.exited, step.hung) or container.exit_code:
                self.good.discard(container.id)
                self.well.discard(container.id)
            elif (
                container.state == "running"
                and step.incarnation == container.incarnation
                and container.service not in self.robot.memory.in_flight  # so rorg does not judge it yet
                and container.digest == desired.digests.get(container.service)
                and step.update.baked == step.update.edition != ""
                and self._stayed_well(container.service)
            ):
                self.well.add(container.id)
                if not self._set_is_incomplete(container):
                    self.good.add(container.id)

    def _stayed_well(self, name: str) -> bool:
        """Whether this very run has stayed well for its bake: its edition may have been proven by an earlier one."""
        since, service = self.robot.memory.of(name).well_since, self.services.get(name)
        return since is not None and service is not None and self.robot.now >= since + service.update.bake

    def _set_is_incomplete(self, container: Container) -> bool:
        """Whether a container stays only if the others of its set stay well too: if not, the set goes back to what was
        in force before its change."""
        service = self.services.get(container.service)
        if service is None or service.update.atomic not in self.robot.desired.sets:
            return False
        step = self.robot.memory.of(container.service)
        pair = candidate(self.robot.read.observed.of(container.service), step.update)
        return pair is not None and pair[0].id == container.id

    def _note_leases(self) -> None:
        """A lease begins when this rorg sees it first, and again while its requester sleeps or the engine is silent."""
        read, life = self.robot.read, self.robot.life
        asleep = {c.service for c in read.observed.containers if c.asleep}
        found = {}
        for request in (r for r in read.requests if r.ttl is not None):
            lease, begins = lease_of(request, read.renewals), request.requester in asleep or life != self.life
            found[lease] = read.now if begins or not read.observed.complete else self.leased.get(lease, read.now)
        self.leased, self.life = found, life

    def _note_unwanted(self) -> None:
        situation = self.robot.decision.situation
        if situation.observed.complete:  # what is wanted only while the engine is silent never began
            wanted = situation.wanted
            self.unwanted = {n: self.unwanted.get(n, self.robot.now) for n in self.services if n not in wanted}
        self._note_quarantined()

    def _note_quarantined(self) -> None:
        """A person may have a change tried again, and so may an engine that stops answering right after it failed."""
        robot, silent = self.robot, not self.robot.read.observed.complete
        self.quarantined = {
            (name, edition): at
            for (name, edition), at in self.quarantined.items()
            if name not in robot.decision.retried and not (silent and robot.now - at <= GOING)
        }
        found = ((name, edition) for name, step in robot.memory.progress.items() for edition in step.update.quarantined)
        self.quarantined = dict.fromkeys(found, robot.now) | self.quarantined

    # -- shorthands for invariants ---------------------------------------------------------------------------------

    @property
    def services(self) -> Mapping[str, Service]:
        return self.robot.desired.catalog.services

    @property
    def eventful(self) -> bool:
        """Whether to compare this pass with one that keeps nothing: passes that differ from the pass before, and some
        of those that do not."""
        return self.repeated % UNEVENTFUL == 0 and not (self.sparing and self.passes % SPARING)

    @property
    def told(self) -> set[str]:
        """Services about which the plan says anything, and those with a call under way."""
        plan = self.robot.decision.plan
        return {a.service for a in plan.actions} | {w.service for w in plan.waitings} | {*self.robot.memory.in_flight}

    def resumed(self) -> set[str]:
        """Declared services whose paused run is being stopped: it runs until it has ended, unless it is killed."""
        flights, found = self.robot.memory.in_flight.items(), {**self.robot.engine.containers}
        if self.call and self.call[1]:
            found[self.call[1].id] = self.call[1]  # as it was before this call
        stops = {n: f.action.operation for n, f in flights if isinstance(f.action.operation, Stop)}
        paused = {n for n, stop in stops.items() if stop.container in found and found[stop.container].state == "paused"}
        return {n for n in paused & self.services.keys() if stops[n].signal != "SIGKILL"}

    def alive(self, but: str = "") -> set[str]:
        """Declared services with a run that goes on, by the engine."""
        found = self.robot.engine.containers.values()
        return {c.service for c in found if c.alive and c.service in self.services} - {but}


def lease_of(request: Request, renewals: Mapping) -> tuple:
    """What makes a lease begin again if it changes."""
    return request.key, request.renewed, request.ttl, renewals.get(request.key, 0)


def known(situation: Situation, id: str) -> Container | None:
    """The container with this id, as observed."""
    return next((c for c in situation.observed.containers if c.id == id), None)


def namespaces(service: Service, container: Container | None) -> list[str]:
    """Containers whose namespaces a container has."""
    joins = joined_of(container.joined) if container else {}
    return [joins[name] for name in ends_with(service.joins) if name in joins]


def closure_of(catalog: Catalog, names: set[str]) -> set[str]:
    """Those that need one of these."""
    return {n for n in catalog.services if names & closure(catalog.services, [n])}


def last_start(watch: Watch, name: str) -> float:
    """When a service was started last, by whomever. The engine's times do not tell: the clock may have been set."""
    return max(at for at, verb, service in watch.robot.engine.calls if (verb, service) == ("start", name))
