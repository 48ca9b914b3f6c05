"""What the loop remembers from one pass to the next, frozen: every step returns a new memory."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from rorg.core.admission import Admitted
from rorg.core.backoff import STALLED_AFTER
from rorg.core.foresight import Foresight
from rorg.core.observed import Container
from rorg.core.operations import Operation, Start
from rorg.core.plan import Action
from rorg.core.pressure import NONE as CALM
from rorg.core.pressure import Pressure
from rorg.core.propagation import CountedOn
from rorg.core.update import Update
from rorg.model.catalog import Probe, Request, Service
from rorg.model.former import Kept

MOST_STOPPED = 16
"""Runs of a service of which it is remembered that we stopped them."""
DEFAULT_GRACE = 5.0
"""Seconds between the stop signal and SIGTERM, where stop_grace_period is not declared."""


@dataclass(frozen=True, slots=True)
class ProbeResult:
    """What the last probe of a service found. `at` is the loop's clock in seconds when the probe began."""

    incarnation: str
    ok: bool
    at: float
    message: str = ""
    failures: int = 0
    """Failures in a row."""


def together(probe: Probe, found: Sequence[ProbeResult | None]) -> ProbeResult | None:
    """What the answers to all questions of a probe say of the whole, in their order; None for one that is not there
    yet. It holds when all do, and is as old as the oldest. None while there is no answer at all."""
    known = [one for one in found if one is not None]
    if not known or len(found) == 1:
        return found[0]
    said = [
        f"{part} has not answered yet" if one is None else one.message
        for part, one in zip(probe.questions, found, strict=True)
        if one is None or not one.ok
    ]
    return ProbeResult(
        known[0].incarnation,
        not said,
        min(one.at for one in known),
        "; ".join(dict.fromkeys(said)),
        max(one.failures for one in known),
    )


ProbeResults = Mapping[tuple[str, str], ProbeResult]
"""By (service, role); the role is ready, live or interlock."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """Of one kind of operation on one service."""

    signature: tuple[str, ...] = ()
    """The action, and what was observed when it was begun."""
    count: int = 0
    """How often that same action was begun with nothing observed to change."""
    at: float = 0.0
    """Not to be begun again before this time."""
    error: str = ""
    missing: bool = False
    """It failed since its image, or its program, is not on this machine: trying again does not help."""
    spent: bool = False
    """It failed since the engine will never start that container again: another one does help."""
    unsupported: bool = False
    """It failed since the engine cannot do that at all."""


NO_ANSWER = "it does not answer any more"
"""Why a run hangs, if what its probe said was forgotten: a changed manifest begins with a clean slate."""


@dataclass(frozen=True, slots=True)
class Progress:
    """Of one service. Times are of the loop's monotonic clock, in seconds."""

    unwanted_since: float | None = None
    ceased_since: float | None = None
    """Since when it is unwanted and does not run."""
    incarnation: str = ""
    running_since: float | None = None
    """Since when its incarnation runs, as far as seen; a resume begins it anew."""
    ready: bool = False
    was_ready: bool = False
    """This run was ready once."""
    well_since: float | None = None
    """Since when this run is ready and answers its `live` probe, without a break."""
    unproven_since: float | None = None
    """The moment of which its next verdict speaks, once that has passed: the verdict waits for a look at its container,
    and for answers of its probes, that begin after it."""
    probe: str = ""
    """What the last probe said."""
    answered: float | None = None
    """When the last readiness probe of this run began that said yes."""
    denied: float | None = None
    """The same of one that said no after a yes."""
    relied_on: str = ""
    """The incarnation that is wanted and ready; also one that was ready under the last rorg and has not yet answered
    this one. Requests lose it when it goes."""
    exits: int = 0
    """Exits in a row while wanted, short of a stable run."""
    exited: str = ""
    """The incarnation whose exit was counted last."""
    stopped: tuple[str, ...] = ()
    """The incarnations, the newest last, that we stopped ourselves, or that ended while nobody wanted them: their exit
    is no failure. Of containers that are there, a run each: the one that is kept may come back after others."""
    doubted_since: float | None = None
    """Since when a run goes on that was being stopped, by an rorg that was killed or by a call that failed."""
    counted_on: CountedOn = CountedOn()
    begun: Mapping[str, str] | None = None
    """Once we begin a start, until it is seen to run: the runs of what it follows, as they were then."""
    hung: str = ""
    """The incarnation that did not answer its `live` probe any more."""
    crashes: int = 0
    """Unexpected ends since it is declared, hung incarnations included."""
    attempts: Mapping[str, Attempt] = field(default_factory=dict)
    """By the verb of the operation. What fails of one holds back no other."""
    error: str = ""
    parameters: str = ""
    """What its ROS parameters were last set for (see ros_parameters.py)."""
    not_set: str = ""
    """Why the last attempt to set them failed."""
    update: Update = Update()

    def with_stopped(self, run: str) -> Progress:
        """From now on the end of this run is our doing."""
        if run in self.stopped:
            return self
        others = [known for known in self.stopped if known.partition("@")[0] != run.partition("@")[0]]
        return replace(self, stopped=(*others[-(MOST_STOPPED - 1) :], run))

    def spent(self, container: Container) -> bool:
        """The engine will not start it again."""
        tried = self.attempt(Start)
        return tried is not None and tried.spent and tried.signature[:1] == (container.id,)

    def over(self, service: Service, container: Container) -> bool:
        """It ended by itself while wanted, and its restart policy leaves it at that."""
        return (
            container.state == "exited"
            and self.exited == container.incarnation
            and (service.restart == "never" or (service.restart == "on-failure" and container.exit_code == 0))
        )

    def attempt(self, operation: Operation | type[Operation]) -> Attempt | None:
        """The last attempt of this kind of operation, if there was any."""
        return self.attempts.get(operation.verb)

    def attempting(self, operation: Operation | type[Operation], attempt: Attempt) -> Progress:
        return replace(self, attempts={**self.attempts, operation.verb: attempt})

    def start_after(self, at: float, error: str) -> Progress:
        """With the next start put off, because of an error."""
        return replace(self.attempting(Start, Attempt(at=at, error=error)), error=error)

    def start_forgotten(self) -> Progress:
        """Without what earlier starts came to: the next one need not wait."""
        return replace(self, attempts={verb: tried for verb, tried in self.attempts.items() if verb != Start.verb})

    @property
    def stalled(self) -> bool:
        return self.exits >= STALLED_AFTER or any(t.count >= STALLED_AFTER for t in self.attempts.values())

    @property
    def missing(self) -> bool:
        """What it is to run is not on this machine."""
        return any(t.missing for t in self.attempts.values())

    @property
    def retry_at(self) -> float:
        """When the last of the attempts that were put off is due."""
        return max((t.at for t in self.attempts.values()), default=0.0)


@dataclass(frozen=True, slots=True)
class InFlight:
    """An action that a worker has, and since when, by the loop's clock."""

    action: Action
    since: float


@dataclass(frozen=True, slots=True)
class Due:
    """A restart that somebody asked for: when (ISO 8601, UTC), and which run is to end by it; "" where there was no
    container."""

    stamp: str
    run: str


@dataclass(frozen=True, slots=True)
class Lease:
    """When a request runs out, by the loop's clock. `stamp` changes with every renewal."""

    stamp: str
    until: float


@dataclass(frozen=True, slots=True)
class Memory:
    """All that a pass passes on to the next one."""

    progress: Mapping[str, Progress] = field(default_factory=dict)
    in_flight: Mapping[str, InFlight] = field(default_factory=dict)
    leases: Mapping[tuple[str, str], Lease] = field(default_factory=dict)
    """By (requester, id)."""
    pressure: Pressure = CALM
    admitted: Admitted | None = None
    """Of the last pass: a cache, which changes nothing if it is missing."""
    asked: tuple[Request, ...] | None = None
    """The requests of the last pass; None before the first one."""
    restarts: Mapping[str, Due] | None = None
    """Restarts that are asked for, by service; None until the first look at what is there."""
    kept: Kept = Kept()
    foresight: Foresight = Foresight()

    def of(self, service: str) -> Progress:
        return self.progress.get(service, NONE)


NONE = Progress()
