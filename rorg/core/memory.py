"""What the loop remembers from one pass to the next, frozen: every step returns a new memory."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from rorg.core.backoff import STABLE, STALLED_AFTER, delay
from rorg.core.observed import Container, Observed
from rorg.core.plan import Action
from rorg.core.wanted import Wanted
from rorg.manifest.catalog import Catalog, Service


@dataclass(frozen=True, slots=True)
class Probe:
    """The last readiness probe of a service. `at` is the loop's clock in seconds when the probe began."""

    incarnation: str
    ok: bool
    at: float
    message: str = ""


@dataclass(frozen=True, slots=True)
class Progress:
    """Of one service. Times are of the loop's monotonic clock, in seconds."""

    unwanted_since: float | None = None
    incarnation: str = ""
    running_since: float | None = None
    """Since when its incarnation runs, as far as seen; a resume begins it anew."""
    ready: bool = False
    probe: str = ""
    """What the last probe said."""
    exits: int = 0
    """Exits in a row while wanted, short of a stable run."""
    exited: str = ""
    """The incarnation whose exit was counted last."""
    stopped: str = ""
    """The incarnation that we stopped ourselves: its exit is no failure."""
    retry_verb: str = ""
    retry_at: float = 0.0
    attempt: tuple = ()
    attempts: int = 0
    """How often the same action was begun with nothing observed to change."""
    error: str = ""

    def over(self, service: Service, container: Container) -> bool:
        """It ended by itself while wanted, and its restart policy leaves it at that."""
        return container.state == "exited" and self.exited == container.incarnation and (
            service.restart == "never" or (service.restart == "on-failure" and container.exit_code == 0))

    @property
    def stalled(self) -> bool:
        return self.attempts >= STALLED_AFTER or self.exits >= STALLED_AFTER


@dataclass(frozen=True, slots=True)
class InFlight:
    action: Action
    since: float


@dataclass(frozen=True, slots=True)
class Memory:
    progress: Mapping[str, Progress] = field(default_factory=dict)
    in_flight: Mapping[str, InFlight] = field(default_factory=dict)

    def of(self, service: str) -> Progress:
        return self.progress.get(service, NONE)


NONE = Progress()


def advance(memory: Memory, catalog: Catalog, found: Wanted, observed: Observed, probes: Mapping[str, Probe],
            now: float, booted_at: str = "") -> Memory:
    """Takes note of what is wanted and observed now: lingering, runs, exits, readiness."""
    if not observed.complete:
        return memory
    by_service = observed.by_service()
    progress = {name: step for name, step in memory.progress.items() if name in by_service}
    for name, service in catalog.services.items():
        if service.meta:
            continue
        containers = by_service.get(name, [])
        current = containers[0] if containers else None
        step = _fresh(_wanted(memory.of(name), name in found, now), current)
        step = _run(step, current, now)
        if name in found and name not in memory.in_flight:
            step = _exit(step, service, current, now, booted_at)
        progress[name] = _ready(step, service, current, probes.get(name), now)
    return replace(memory, progress=progress)


def _wanted(step: Progress, is_wanted: bool, now: float) -> Progress:
    if is_wanted:
        return replace(step, unwanted_since=None) if step.unwanted_since is not None else step
    if step.unwanted_since is not None:
        return step
    # Whoever asks for it again gets a fresh start.
    return replace(step, unwanted_since=now, exits=0, exited="", retry_verb="", retry_at=0.0, attempts=0, attempt=(),
                   error="")


def _fresh(step: Progress, current: Container | None) -> Progress:
    """Another container has no part in what the one before it did."""
    if not step.exited or current is None or step.exited.startswith(current.id[:12]):
        return step
    return replace(step, exits=0, exited="", retry_verb="", retry_at=0.0, error="")


def _run(step: Progress, current: Container | None, now: float) -> Progress:
    if current is None or current.state != "running":
        if step.running_since is None and not step.ready:
            return step
        return replace(step, running_since=None, ready=False, probe="")
    if step.running_since is None or step.incarnation != current.incarnation:
        return replace(step, incarnation=current.incarnation, running_since=now, ready=False, probe="")
    if step.exits and now - step.running_since >= STABLE:
        return replace(step, exits=0, error="")
    return step


def _exit(step: Progress, service: Service, current: Container | None, now: float, booted_at: str) -> Progress:
    if current is None or current.state != "exited" or not current.started_at or current.started_at < booted_at:
        return step
    run = current.incarnation
    if run in (step.exited, step.stopped):
        return step
    exits = step.exits + 1
    why = "out of memory" if current.oom_killed else f"exit code {current.exit_code}"
    return replace(step, exits=exits, exited=run, retry_verb="start", retry_at=now + delay(exits),
                   error=f"ended with {why}", attempts=0, attempt=())


def _ready(step: Progress, service: Service, current: Container | None, probe: Probe | None, now: float) -> Progress:
    if step.running_since is None or step.ready or current is None:
        return step
    if service.ready is None:
        return replace(step, ready=True)
    if service.ready.probe == "delay":
        # The same sum as the deadline that the loop sleeps for: a difference may round to just below it, for ever.
        return replace(step, ready=True) if now >= step.running_since + float(service.ready.target) else step
    if probe and probe.incarnation == step.incarnation and probe.at >= step.running_since:
        if probe.ok:
            return replace(step, ready=True, probe="")
        if probe.message != step.probe:
            return replace(step, probe=probe.message)
    return step


def begin(memory: Memory, action: Action, observed: Observed, now: float) -> Memory:
    """An action is handed to a worker: its service gets no second one until the outcome."""
    step = memory.of(action.service)
    state = tuple((c.id, c.state, c.name, c.incarnation) for c in observed.by_service().get(action.service, []))
    signature = (action.verb, action.container, action.args.get("digest", ""), state)
    attempts = step.attempts + 1 if signature == step.attempt else 1
    step = replace(step, attempt=signature, attempts=attempts)
    return Memory({**memory.progress, action.service: step},
                  {**memory.in_flight, action.service: InFlight(action, now)})


def finish(memory: Memory, action: Action, error: str, incarnation: str, now: float) -> Memory:
    """The outcome of an action. `error` is empty when it went well; `incarnation` is the one that a stop ended."""
    in_flight = {name: flight for name, flight in memory.in_flight.items() if name != action.service}
    step = memory.of(action.service)
    if error or step.attempts >= STALLED_AFTER:
        step = replace(step, retry_verb=action.verb, retry_at=now + delay(step.attempts + 1), error=error)
    elif step.retry_verb == action.verb and not step.exits:
        step = replace(step, retry_verb="", retry_at=0.0, error="")
    if action.verb == "stop" and not error:
        step = replace(step, stopped=incarnation)
    return Memory({**memory.progress, action.service: step}, in_flight)
