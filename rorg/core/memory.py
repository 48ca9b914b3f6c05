"""What the loop remembers between passes. All values are frozen: each step returns a new memory, so a pass that is
aborted leaves no trace."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from rorg.core.admission import Admitted
from rorg.core.observed import Container
from rorg.core.operations import Operation, Remove, Start
from rorg.core.plan import Action
from rorg.core.pressure import NONE as CALM
from rorg.core.pressure import Pressure
from rorg.core.update import Update
from rorg.model.catalog import Request, Service
from rorg.model.former import Kept
from rorg.model.probe import Probe

CAP = 60.0
"""Seconds. Kubernetes waits up to five minutes, but on a robot someone is usually waiting next to it."""
STABLE = 60.0
"""Seconds after which a run counts as stable and earlier exits are forgotten."""
STALLED_AFTER = 3
"""A service is Stalled after this many identical actions in a row without any observed change."""
MOST_STOPPED = 16
"""Number of runs per service that are remembered as stopped by rorg."""
DEFAULT_GRACE = 5.0
"""Seconds between the stop signal and SIGKILL if `stop_grace_period` is not declared."""


@dataclass(frozen=True, slots=True)
class ProbeResult:
    """The last result of a probe. `at` is when the probe began, by the loop's clock in seconds."""

    incarnation: str
    ok: bool
    at: float
    message: str = ""
    failures: int = 0
    """Consecutive failures."""
    probe: Probe | None = None
    """What it answers."""


def together(probe: Probe, results: Sequence[ProbeResult | None]) -> ProbeResult | None:
    """Combine the results of all questions of a probe, in their order; None stands for a missing result.

    The whole is ok if all are, and as old as the oldest. None if there is no result at all.
    """
    known = [result for result in results if result is not None]
    if not known:
        return None
    if len(results) == 1:
        return replace(known[0], probe=probe)
    problems = [
        f"{part} has not answered yet" if result is None else result.message
        for part, result in zip(probe.questions, results, strict=True)
        if result is None or not result.ok
    ]
    return ProbeResult(
        known[0].incarnation,
        not problems,
        min(result.at for result in known),
        "; ".join(dict.fromkeys(problems)),
        max(result.failures for result in known),
        probe,
    )


ProbeResults = Mapping[tuple[str, str], ProbeResult]
"""By (service, role); the role is ready, live or interlock."""


@dataclass(frozen=True, slots=True)
class Attempt:
    """The last attempts of one kind of operation on one service."""

    signature: tuple[str, ...] = ()
    """The action, and what was observed when it began."""
    count: int = 0
    """How often the same action began in a row without any observed change."""
    at: float = 0.0
    """The earliest time of the next attempt."""
    error: str = ""
    missing: bool = False
    """It failed because an image or program is missing here, so retrying does not help."""
    spent: bool = False
    """It failed because the engine will never start this container again; a new container helps."""
    unsupported: bool = False
    """It failed because the engine does not support the operation."""
    unanswered: bool = False
    """The engine did not answer, as when it restarts, which says nothing about the service."""

    @property
    def stalled(self) -> bool:
        return self.count >= STALLED_AFTER and not self.unanswered


NO_ANSWER = "it does not answer any more"
"""Why a run hangs, if what its probe said was forgotten: a changed manifest begins with a clean slate."""


@dataclass(frozen=True, slots=True)
class CountedOn:
    """The runs of needs on which one run of a service relies, for needs declared with `restart: true`. It tells a need
    that was restarted from one that was only added to the manifest. A ROS node is lost to the graph when roscore
    restarts, so it must restart too."""

    run: str = ""
    """The service's own incarnation."""
    needs: Mapping[str, str] = field(default_factory=dict)
    """Need -> incarnation; "" if it was already restarted when this was noticed."""

    def lost(self, need: str, container: Container, now: Container) -> bool:
        """Return whether the run of `container` relied on a run of the need that is over."""
        counted_on = self.needs.get(need, now.incarnation)
        return not now.brief and self.run == container.incarnation and counted_on != now.incarnation


@dataclass(frozen=True, slots=True)
class Progress:
    """The memory of one service. Times are of the loop's monotonic clock, in seconds."""

    unwanted_since: float | None = None
    ceased_since: float | None = None
    """Since when it is unwanted and not running."""
    incarnation: str = ""
    running_since: float | None = None
    """Since when its incarnation was seen running; a resume resets it."""
    ready: bool = False
    was_ready: bool = False
    """Whether this run was ever ready."""
    well_since: float | None = None
    """Since when this run has been ready and answering its `live` probe without interruption."""
    unproven_since: float | None = None
    """A verdict is due about this moment. It needs a look at the container and probe results that began later, because
    older ones say nothing about that moment."""
    probe: str = ""
    """The last probe's message."""
    answered: float | None = None
    """When the last successful readiness probe of this run began."""
    denied: float | None = None
    """When the last readiness probe began that failed after a success."""
    relied_on: str = ""
    """The incarnation that is wanted and ready. After a restart of rorg, also one that was ready before and has not
    been probed yet, so that a restart of rorg alone costs no request its service."""
    exits: int = 0
    """Consecutive exits while wanted, reset by a stable run."""
    exited: str = ""
    """The incarnation whose exit was counted last."""
    stopped: tuple[str, ...] = ()
    """Incarnations that rorg stopped, or that ended while unwanted, newest last: their exit is no failure. One run per
    existing container, because a kept previous container may come back later."""
    doubted_since: float | None = None
    """Since when a run that was being stopped goes on: rorg was killed meanwhile, or the call failed."""
    counted_on: CountedOn = CountedOn()
    begun: Mapping[str, str] | None = None
    """From rorg's start call until the service is seen running: the runs of its needs at that time."""
    hung: str = ""
    """The incarnation that stopped answering its `live` probe."""
    crashes: int = 0
    """Unexpected ends since the service was declared, including hung runs."""
    attempts: Mapping[str, Attempt] = field(default_factory=dict)
    """By verb. A failure of one operation does not hold back the others."""
    removals: Mapping[str, Attempt] = field(default_factory=dict)
    """The same of removals, by container. The service does not depend on these."""
    error: str = ""
    parameters: str = ""
    """For which runs and values its ROS parameters were last set (see ros_parameters.py)."""
    not_set: str = ""
    """Why the last attempt to set them failed."""
    begun_with: tuple[str, str] = ("", "")
    """(incarnation, digest of the ROS 2 parameters that it read when it started)."""
    rebooted: bool = False
    """The machine was booted since an earlier rorg wrote this. So what ran then has ended with it."""
    update: Update = Update()

    def with_stopped(self, run: str) -> Progress:
        """Note that rorg ends this run."""
        if run in self.stopped:
            return self
        others = [known for known in self.stopped if known.partition("@")[0] != run.partition("@")[0]]
        return replace(self, stopped=(*others[-(MOST_STOPPED - 1) :], run))

    def spent(self, container: Container) -> bool:
        """Return whether the engine will never start this container again."""
        tried = self.attempt(Start)
        return tried is not None and tried.spent and tried.signature[:1] == (container.id,)

    def useless(self, container: Container) -> str:
        """Return why the engine can do nothing more with a container; "" if it can."""
        if container.lost:
            return "the engine is removing it" if container.state == "removing" else "the engine calls it dead"
        return "the engine cannot start it any more" if self.spent(container) else ""

    def over(self, service: Service, container: Container) -> bool:
        """Return whether it ended on its own while wanted and its restart policy does not restart it."""
        return (
            container.state == "exited"
            and self.exited == container.incarnation
            and not service.restarts_after(container.exit_code)
        )

    def attempt(self, operation: Operation | type[Operation]) -> Attempt | None:
        """Return the last attempt of this kind of operation, if any; for a removal, that of the same container."""
        if isinstance(operation, Remove):
            return self.removals.get(operation.container)
        return self.attempts.get(operation.verb)

    def attempting(self, operation: Operation | type[Operation], attempt: Attempt) -> Progress:
        """Note an attempt."""
        if isinstance(operation, Remove):
            return replace(self, removals={**self.removals, operation.container: attempt})
        return replace(self, attempts={**self.attempts, operation.verb: attempt})

    def start_after(self, at: float, error: str) -> Progress:
        """Postpone the next start because of an error."""
        return replace(self.attempting(Start, Attempt(at=at, error=error)), error=error)

    def start_forgotten(self) -> Progress:
        """Forget earlier starts, so that the next one need not wait."""
        return replace(self, attempts={verb: tried for verb, tried in self.attempts.items() if verb != Start.verb})

    @property
    def stalled(self) -> bool:
        return self.exits >= STALLED_AFTER or any(t.stalled for t in self.attempts.values())

    @property
    def missing(self) -> bool:
        """Whether an image or program it needs is missing on this machine."""
        return any(t.missing for t in self.attempts.values())

    @property
    def retry_at(self) -> float:
        """When the last of its postponed attempts is due."""
        return max((t.at for t in self.attempts.values()), default=0.0)


@dataclass(frozen=True, slots=True)
class InFlight:
    """An action that a worker executes, and since when by the loop's clock."""

    action: Action
    since: float


@dataclass(frozen=True, slots=True)
class Due:
    """A requested restart: when it is due (ISO 8601, UTC), and the run it must end ("" if there was no container)."""

    stamp: str
    run: str


@dataclass(frozen=True, slots=True)
class Lease:
    """When a request expires, by the loop's clock. `stamp` changes with every renewal."""

    stamp: str
    until: float


@dataclass(frozen=True, slots=True)
class Memory:
    """Everything that a pass hands to the next one."""

    progress: Mapping[str, Progress] = field(default_factory=dict)
    in_flight: Mapping[str, InFlight] = field(default_factory=dict)
    leases: Mapping[tuple[str, str], Lease] = field(default_factory=dict)
    """By (requester, id)."""
    pressure: Pressure = CALM
    admitted: Admitted = Admitted()
    """The admission of the last pass, to be reused."""
    asked: tuple[Request, ...] | None = None
    """The requests of the last pass; None before the first one."""
    restarts: Mapping[str, Due] = field(default_factory=dict)
    """Requested restarts by service. They outlive rorg, so that none is done twice."""
    kept: Kept = Kept()
    outage: bool | None = None
    """Whether the engine did not answer in the last pass, though it had before; None until it first answers."""

    def of(self, service: str) -> Progress:
        return self.progress.get(service, NONE)


NONE = Progress()


def delay(failures: int) -> float:
    """Return seconds to wait after this many failures in a row: 0 after the first, then 1, 2, 4 and so on up to CAP."""
    return 0.0 if failures <= 1 else min(2.0 ** min(failures - 2, 10), CAP)
