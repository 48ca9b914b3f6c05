"""Transitions of a service's progress with what is observed: lingering, runs, exits, readiness and life.

Each function handles one aspect and returns the same object if nothing changed, so that tracking.py can tell cheaply
whether a service needs another look.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from rorg.core.liveness import after_live, is_of_run
from rorg.core.memory import DEFAULT_GRACE, STABLE, CountedOn, ProbeResult, Progress, delay
from rorg.core.observed import PROCESS_GONE, Container, Observed
from rorg.core.operations import Start
from rorg.core.probes_in_force import is_live_untried, is_ready_untried
from rorg.model.catalog import Service

UNANSWERED: dict[str, Any] = {
    "ready": False,
    "was_ready": False,
    "well_since": None,
    "probe": "",
    "answered": None,
    "denied": None,
}
"""Fields of a run that no probe has answered for yet."""
REPEATED = 2
"""A trial that something else interrupts is repeated this often: its edition may be what takes the machine down."""
MARGIN = 4.0
"""Seconds beyond the grace period that an engine takes to kill what ignores its stop signal."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """What a pass observes of one service, to judge its progress by.

    - `ready`, `live`: its probe results;
    - `busy`: an engine call on it is under way;
    - `unplugged`: a device of it is missing;
    - `outage`: the engine answers again, and may have ended the run while it did not;
    - `now`: the loop's clock, in seconds.
    """

    wanted: bool
    observed: Observed
    ready: ProbeResult | None
    live: ProbeResult | None
    busy: bool
    now: float
    unplugged: bool = False
    outage: bool = False

    def looked_since(self, container: Container, moment: float) -> bool:
        """Return whether a look at the container began after that moment."""
        return self.observed.looked.get(container.id, -1.0) >= moment


def advanced(progress: Progress, service: Service, evidence: Evidence) -> Progress:
    """Return the progress after what was observed of a service in this pass. `service` has the probes in force."""
    current, now = evidence.observed.current(service.name), evidence.now
    progress = _fresh(_wanted(progress, evidence.wanted, now), current)
    progress = _ceased(_run(progress, current, now), current, now)
    counted_on = _counted_on(progress, service, current, evidence)
    progress = progress if counted_on is progress.counted_on else replace(progress, counted_on=counted_on, begun=None)
    if not evidence.wanted and current is not None and current.state == "exited":
        progress = progress.with_stopped(current.incarnation)
    progress = _doubt(progress, service, None if evidence.busy else current, now)
    if evidence.wanted and not evidence.busy:
        progress = _ended_with_another(progress, service, evidence)
        progress = _exit(_excused(progress, service, current, evidence), service, current, evidence)
    is_kept = is_ready_untried(service, progress.update, current)
    progress = _ready(progress, service, evidence.ready, now, is_kept)
    if evidence.wanted and not evidence.busy and not is_live_untried(service, progress.update, current):
        progress = after_live(progress, service, evidence.live, now)
    progress = _relied_on(progress, service, evidence.wanted, now)
    return _patient(_well(progress, now)) if evidence.unplugged else _well(progress, now)


def _patient(progress: Progress) -> Progress:
    """Drop the back-off of a service without its device: failures without it say nothing, and the service must start as
    soon as the device is back."""
    if not (progress.exits or progress.attempt(Start)):
        return progress
    return replace(progress.start_forgotten(), exits=0, error="")


def _wanted(progress: Progress, is_wanted: bool, now: float) -> Progress:
    """Note since when a service is unwanted; a service that becomes wanted or unwanted loses its back-off."""
    # A new request gets a fresh attempt: what was missing may exist by now.
    if is_wanted == (progress.unwanted_since is None):
        return progress
    if is_wanted:
        return replace(progress, unwanted_since=None, attempts={}, error="")
    return replace(progress, unwanted_since=now, exits=0, exited="", attempts={}, error="")


def _fresh(progress: Progress, current: Container | None) -> Progress:
    """Forget the failures of the previous container; the current one has no part in them."""
    if not progress.exited or current is None or progress.exited.startswith(current.id[:12]):
        return progress
    return replace(progress, exits=0, exited="", attempts={}, error="")


def _run(progress: Progress, current: Container | None, now: float) -> Progress:
    """Note a new run, its end, or that it has become stable."""
    if current is None or current.state != "running" or current.vanished:
        if progress.running_since is None:
            return progress
        return replace(progress, running_since=None, **UNANSWERED)
    if progress.running_since is None or progress.incarnation != current.incarnation:
        return replace(progress, incarnation=current.incarnation, running_since=now, **UNANSWERED)
    if progress.exits and progress.hung != progress.incarnation and now - progress.running_since >= STABLE:
        return replace(progress.start_forgotten(), exits=0, error="")
    return progress


def _ceased(progress: Progress, current: Container | None, now: float) -> Progress:
    """Note since when an unwanted service does not run."""
    if progress.unwanted_since is None or current is None or current.active:
        return replace(progress, ceased_since=None) if progress.ceased_since is not None else progress
    return replace(progress, ceased_since=now) if progress.ceased_since is None else progress


def _counted_on(progress: Progress, service: Service, current: Container | None, evidence: Evidence) -> CountedOn:
    """Note what a run relies on, once per need.

    For a run that rorg began, these are the runs at that time (`begun`). For a run that rorg finds, they are the
    present ones, because a new rorg must restart nothing on its own. A need that is added later is taken as it is.
    """
    known = progress.counted_on
    if current is None or not current.alive or current.brief:
        return known
    first = known.run != current.incarnation
    needs = (progress.begun or {}) if first else known.needs
    needs = {n: run for n, run in needs.items() if n in service.restarts_with}
    for need in service.restarts_with:
        container = evidence.observed.current(need)
        if need in needs or container is None or not container.started_at:
            continue
        if first or container.alive:
            needs[need] = container.incarnation
    return known if not first and needs == known.needs else CountedOn(current.incarnation, needs)


def doubt_ends(progress: Progress, service: Service) -> float | None:
    """Return when a run that was being stopped counts as going on after all; None if none was."""
    grace = float(service.options.get("stop_grace_period", DEFAULT_GRACE))
    return None if progress.doubted_since is None else progress.doubted_since + grace + MARGIN


def _doubt(progress: Progress, service: Service, current: Container | None, now: float) -> Progress:
    """Suspend judgement of a run that was being stopped, by an rorg that was killed or a call that failed, until it
    must have ended."""
    if current is None or not current.alive or current.incarnation not in progress.stopped:
        return replace(progress, doubted_since=None) if progress.doubted_since is not None else progress
    if progress.doubted_since is None:
        return replace(progress, doubted_since=now)
    if now < (doubt_ends(progress, service) or 0.0):
        return progress
    left = tuple(run for run in progress.stopped if run != current.incarnation)
    return replace(progress, stopped=left, doubted_since=None)


def _ended_with_another(progress: Progress, service: Service, evidence: Evidence) -> Progress:
    """Excuse an exit caused by another container: when a shared PID namespace ends, the kernel kills every process in
    it."""
    current = evidence.observed.current(service.name)
    if current is None or current.state != "exited":
        return progress
    for name in (n for n, options in service.joins.items() if "pid" in options):
        other = evidence.observed.current(name)
        if other is None or not other.alive or progress.counted_on.lost(name, current, other):
            return progress.with_stopped(current.incarnation)
    return progress


def _excused(progress: Progress, service: Service, current: Container | None, evidence: Evidence) -> Progress:
    """Blame no program for an end that rorg did not see and that something else may have caused. But an edition that
    ends like that again and again may be the cause."""
    if current is None or not current.ended or current.incarnation in (progress.exited, *progress.stopped):
        return progress
    update = progress.update
    proven = update.baked == update.edition
    if not _interrupted(progress, service, current, evidence) or (update.interrupted >= REPEATED and not proven):
        return progress
    update = update if proven else replace(update, interrupted=update.interrupted + 1)
    return replace(progress.with_stopped(current.incarnation), update=update)


def _interrupted(progress: Progress, service: Service, current: Container, evidence: Evidence) -> bool:
    """Return whether something else may have ended a run: the engine, which did not answer (a restart of Docker ends
    all containers) or did not notice; a person's `docker stop`; a reboot; or, while no rorg ran, whatever killed the
    program. An edition that is still tried gets another try however its run ended then, because programs handle SIGTERM
    in their own ways. What ends for good is over, and must not run twice."""
    again, tried = service.restarts_after(current.exit_code), progress.update.baked != progress.update.edition
    if progress.incarnation == current.incarnation or progress.begun is not None:  # this rorg saw it, or began it
        return again and (evidence.outage or (tried and (current.vanished or current.signalled)))
    return progress.rebooted or ((current.killed or tried) and again)


def _exit(progress: Progress, service: Service, current: Container | None, evidence: Evidence) -> Progress:
    """Note an exit. Count it and postpone the next start, unless the service has completed."""
    if current is None or not current.ended or not current.started_at:
        return progress
    run = current.incarnation
    if run == progress.exited or run in progress.stopped:
        return progress
    if current.exit_code == 0 and not service.restarts_after(0):
        return replace(progress.start_forgotten(), exits=0, exited=run, error="")
    exits = progress.exits + 1
    why = "killed: out of memory" if current.oom_killed else f"ended with exit code {current.exit_code}"
    progress = replace(progress, exits=exits, crashes=progress.crashes + 1, exited=run)
    return progress.start_after(evidence.now + delay(exits), PROCESS_GONE if current.vanished else why)


def _ready(
    progress: Progress, service: Service, result: ProbeResult | None, now: float, is_kept: bool = False
) -> Progress:
    """Note readiness, by probe, by delay, or by merely running. If it `is_kept`, no denial takes it away."""
    if progress.running_since is None:
        return progress
    if progress.doubted_since is not None:
        return replace(progress, ready=False) if progress.ready else progress
    if service.ready is None:
        return replace(progress, ready=True, was_ready=True) if not progress.ready else progress
    if service.ready.delay is not None:
        # Compute this sum exactly as the loop's deadline does. Another form may round to just below it, and the loop
        # would wake up for ever without effect.
        is_due = not progress.ready and now >= progress.running_since + service.ready.delay
        return replace(progress, ready=True, was_ready=True) if is_due else progress
    if not is_of_run(result, progress, service.ready):
        return progress
    if result.ok and result.at != progress.answered:
        progress = replace(progress, answered=result.at)
    if progress.ready:
        return _still_ready(progress, result, 0 if is_kept else service.ready.failures)
    if result.ok:
        return replace(progress, ready=True, was_ready=True, probe="")
    return replace(progress, probe=result.message) if result.message != progress.probe else progress


def _relied_on(progress: Progress, service: Service, wanted: bool, now: float) -> Progress:
    """Keep the run that was ready before rorg restarted until its probe answers or is late. Otherwise every restart of
    rorg would report all services as lost."""
    if not wanted or progress.running_since is None:
        run = ""
    elif progress.ready:
        run = progress.incarnation
    else:
        late = service.ready is not None and now >= progress.running_since + service.ready.timeout
        unasked = progress.relied_on == progress.incarnation and not progress.was_ready and not late
        run = progress.relied_on if unasked else ""
    return progress if run == progress.relied_on else replace(progress, relied_on=run)


def _still_ready(progress: Progress, result: ProbeResult, failures: int) -> Progress:
    """Return whether enough consecutive probes failed for readiness to be lost. With 0 `failures` it never is."""
    if result.ok:
        return replace(progress, probe="") if progress.probe else progress
    if failures and result.failures >= failures:
        return replace(progress, ready=False, probe=result.message)
    return replace(progress, denied=result.at, probe=result.message) if result.at != progress.denied else progress


def _well(progress: Progress, now: float) -> Progress:
    """Note since when a run has been ready and answering."""
    well = progress.ready and progress.hung != progress.incarnation
    if well == (progress.well_since is not None):
        return progress
    return replace(progress, well_since=now if well else None)
