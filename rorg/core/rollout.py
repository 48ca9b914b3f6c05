"""Rollout of a new container: the previous one is kept until the new one is ready and has stayed well for its bake.
Otherwise rorg goes back to the previous one and quarantines what failed: it is not tried again until it changes or a
person runs `rorg retry`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import inf

from rorg.core.changes import updated
from rorg.core.desired import Desired
from rorg.core.liveness import denies_life, is_of_run
from rorg.core.memory import NO_ANSWER, STABLE, Memory, ProbeResult, Progress
from rorg.core.observed import Container
from rorg.core.operations import Start
from rorg.core.plan import Action
from rorg.core.probes_in_force import fits, is_as_proven, is_live_untried, is_ready_untried
from rorg.core.transitions import Evidence
from rorg.core.trial import candidate, went_back
from rorg.core.update import LastGood
from rorg.model.catalog import Service
from rorg.model.units import format_seconds

GOING = 30.0
"""Seconds before an engine stops answering in which it may have ended containers: Docker gives them 15 s when it is
stopped."""
TRIAL = 2.0
"""Seconds of running after which a service without a readiness probe has come up."""


def came_up_at(progress: Progress, service: Service) -> float | None:
    """Return when a run has come up, so that other services may rely on it: when it is ready, if there is a probe;
    otherwise after a moment of running, but not later than its bake. None while it is not ready."""
    if progress.well_since is None:
        return None
    return progress.well_since if _is_asked(service) else progress.well_since + min(TRIAL, service.update.bake)


def has_come_up(progress: Progress, service: Service, looked: float | None, now: float) -> bool:
    """Return whether other services may rely on a run. Without a probe, a look at its container must have begun since
    it came up; `looked` is when the last one began."""
    up = came_up_at(progress, service)
    return up is not None and up <= now and (_is_asked(service) or (looked is not None and looked >= up))


def _is_asked(service: Service) -> bool:
    """Return whether a probe tells its readiness, rather than a delay."""
    return service.ready is not None and service.ready.delay is None


def renewed(progress: Progress, edition: str, now: float) -> Progress:
    """Start a new edition of a service without back-off and with new probe results."""
    update = progress.update
    if update.edition == edition:
        return progress
    if not update.edition:
        return replace(progress, update=replace(update, edition=edition))
    update = replace(update, edition=edition, since=now, interrupted=0)
    update = replace(update, failed_at=-inf)  # that was another edition
    return replace(progress, exits=0, attempts={}, error="", update=update)


@dataclass(frozen=True, slots=True)
class _Verdict:
    """The verdict on a run. Without `passed` and `error` it is open: more time is needed, or, with `since`, a look at
    the container and probe results that began after that moment."""

    passed: bool = False
    error: str = ""
    since: float | None = None


_OPEN = _Verdict()


def judged(progress: Progress, service: Service, desired: Desired, evidence: Evidence) -> Progress:
    """Note the end of a trial, an edition that has stayed well, and one that ends again and again. Only for a wanted
    service on which no call is under way."""
    if not evidence.wanted or evidence.busy or evidence.unplugged or progress.update.drawn:
        return _awaiting(progress, None)
    return _broken_or_mended(_judged(progress, service, desired, evidence), service, evidence.now)


def _broken_or_mended(progress: Progress, service: Service, now: float) -> Progress:
    """Note that the desired edition fails again and again, or that a run of it has been well for long enough to show
    that it does not."""
    update = progress.update
    if progress.stalled and not update.failed:
        why = progress.error or "it has no effect"
        return progress if update.broken else replace(progress, update=update.noting_crashes(why))
    mended_at = mended_from(progress, service)
    return progress if mended_at is None or mended_at > now else replace(progress, update=update.noting_crashes(""))


def mended_from(progress: Progress, service: Service) -> float | None:
    """Return from when a run shows that an edition that failed is well again; None if it does not. Its bake is too
    short to tell, because a program may end later each time; the run must be stable."""
    update = progress.update
    if not update.broken or progress.well_since is None or update.baked != update.edition:
        return None
    return progress.well_since + max(STABLE, service.update.bake)


def _judged(progress: Progress, service: Service, desired: Desired, evidence: Evidence) -> Progress:
    containers = evidence.observed.of(service.name)
    if not containers:
        return _awaiting(progress, None)
    pair = candidate(containers, progress.update)
    if pair is None:
        return _judged_alone(progress, service, containers[0], desired, evidence)
    new, old = pair
    verdict = _OPEN
    if went_back(new, old) and new.id != progress.update.spared:
        # If no failure is noted, an earlier run of rorg went back, and ended before it could note it.
        verdict = _Verdict(error=new.error or f"ended with exit code {new.exit_code}")
    elif containers[0].id == new.id:
        verdict = _verdict(progress, service, new, evidence)
        up = came_up_at(progress, service)
        if verdict == _OPEN and up is not None and up <= evidence.now and not _is_asked(service):
            verdict = _Verdict(since=up)  # others may rely on it from then on
    progress = _awaiting(progress, verdict.since)
    if verdict.passed:
        progress = _baked(progress, service, new, desired)
        progress = replace(progress, update=progress.update.accepting(new.id))
        # In a set, none is proven before all are (see atomic.py).
        together = service.update.atomic in desired.sets
        return progress if together else replace(progress, update=replace(progress.update, proven=new.id))
    if not (verdict.error and fits(new, service.name, desired)):
        return progress
    return failed(progress, verdict.error, evidence.now, new.id)


def _judged_alone(
    progress: Progress, service: Service, current: Container, desired: Desired, evidence: Evidence
) -> Progress:
    """Judge a service without a previous container. If only its probes or files changed, the container that was proven
    is tried with them; if it does not answer in time, the change has failed. One that was never proven is then no
    longer ready."""
    update = progress.update
    if update.is_proven(current.id) or update.failed or not fits(current, service.name, desired):
        return _awaiting(progress, None)
    if is_live_untried(service, update, current) and denies_life(progress, service, evidence.live):
        message = evidence.live.message if evidence.live else ""
        return failed(_awaiting(progress, None), f"did not answer ({message})", evidence.now)
    verdict = _verdict(progress, service, current, evidence)
    progress = _awaiting(progress, verdict.since)
    if verdict.passed:
        return _baked(progress, service, current, desired)
    if not verdict.error or progress.running_since is None or progress.hung == progress.incarnation:
        return progress
    if update.baked == update.edition:
        return progress  # an earlier container has shown that the change is good
    if is_ready_untried(service, update, current):
        return replace(failed(progress, verdict.error, evidence.now), probe="")
    if is_as_proven(update, current):
        progress = failed(progress, verdict.error, evidence.now)
    elif not progress.ready:
        return progress
    return replace(progress, ready=False, was_ready=False, well_since=None)


def _awaiting(progress: Progress, since: float | None) -> Progress:
    return progress if progress.unproven_since == since else replace(progress, unproven_since=since)


def _verdict(progress: Progress, service: Service, current: Container, evidence: Evidence) -> _Verdict:
    """Return whether a run has stayed well for its bake, or what is wrong with it."""
    if current.ended and progress.exited == current.incarnation:
        done = current.exit_code == 0 and progress.over(service, current)
        return _Verdict(passed=True) if done else _Verdict(error=progress.error)
    if current.state != "running" or progress.running_since is None or progress.doubted_since is not None:
        return _OPEN
    if progress.well_since is not None:
        return _of_a_bake(progress, service, current, evidence)
    if progress.hung == progress.incarnation:
        return _Verdict(error=progress.error or NO_ANSWER)
    said = f": {progress.probe}" if progress.probe else ""
    if progress.was_ready:
        return _Verdict(error=f"no longer ready{said}")
    late_at = is_late_at(progress, service)
    if late_at is None or evidence.now < late_at:
        return _OPEN
    told = evidence.looked_since(current, late_at) and _answers(progress, service, evidence, late_at) is not None
    return _Verdict(error=_not_ready(service, said)) if told else _Verdict(since=late_at)


def bake_ends_at(progress: Progress, service: Service) -> float | None:
    """Return when a run has been well for its bake, if nothing goes wrong. The bake does not begin before its edition
    is declared and its program has been told to read it."""
    return (
        None if progress.well_since is None else max(progress.well_since, progress.update.since) + service.update.bake
    )


def is_late_at(progress: Progress, service: Service) -> float | None:
    """Return when a run that is not ready, according to its present probe, has had enough time for it."""
    ready = service.ready
    if progress.running_since is None or ready is None or ready.delay is not None:
        return None
    since = bake_ends_at(progress, service)
    return (max(progress.running_since, progress.update.since) if since is None else since) + ready.timeout


def _of_a_bake(progress: Progress, service: Service, current: Container, evidence: Evidence) -> _Verdict:
    """Judge a run that is well as far as known. If its `ready` probe stops answering, it has its timeout to recover."""
    bake_end = bake_ends_at(progress, service)
    if bake_end is None or evidence.now < bake_end:
        return _OPEN
    answers = _answers(progress, service, evidence, bake_end)
    if answers is None or not evidence.looked_since(current, bake_end):
        return _Verdict(since=bake_end)
    if all(result.ok for result in answers):
        return _Verdict(passed=True)
    late_at, result = is_late_at(progress, service), evidence.ready
    if late_at is None or result is None or evidence.now < late_at or not result.failures:
        return _Verdict(since=bake_end)
    return _Verdict(error=_not_ready(service, f": {result.message}"))


def _answers(progress: Progress, service: Service, evidence: Evidence, since: float) -> Sequence[ProbeResult] | None:
    """Return the probe results of a run that began since; None while one is missing."""
    asked = [(service.ready, evidence.ready)] if service.ready and _is_asked(service) else []
    asked += [(service.live, evidence.live)] if service.live is not None and progress.was_ready else []
    results = [result for probe, result in asked if is_of_run(result, progress, probe) and result.at >= since]
    return results if len(results) == len(asked) else None


def _not_ready(service: Service, said: str) -> str:
    return f"not ready within {format_seconds(service.ready.timeout if service.ready else 0.0)}{said}"


def _baked(progress: Progress, service: Service, current: Container, desired: Desired) -> Progress:
    """Note that the edition has stayed well in this container. An earlier container may have shown it before."""
    update, name = progress.update, service.name
    if update.is_proven(current.id) or not fits(current, name, desired):
        return progress
    if service.on_change != "none" and update.changed_content(current, desired.contents.get(name, {})):
        return progress  # this run has not read the present content
    last_good = LastGood(desired.digests[name], service.ready, service.live)
    return replace(progress, update=replace(update, baked=update.edition, well=current.id, last_good=last_good))


def failed(progress: Progress, error: str, now: float, container: str = "") -> Progress:
    """Quarantine the desired edition, and reject the `container` that was tried, if one was. The previous container
    starts without back-off."""
    if progress.update.edition in progress.update.quarantined:
        return progress
    update = progress.update.quarantine(error, now)
    update = replace(update, rejected=container or update.rejected)
    return replace(progress, exits=0, attempts={}, error="", update=update)


def refused(progress: Progress, action: Action, error: str, now: float) -> Progress:
    """Note that the engine refused a trial's start because of what was asked, rather than not answering."""
    operation = action.operation
    tried = operation.trial if isinstance(operation, Start) else ""
    return failed(progress, error, now, operation.container) if tried and tried == progress.update.edition else progress


def retried(memory: Memory, asked: Mapping[str, str]) -> Memory:
    """Lift the quarantine of these services, once per request. What failed must be proven anew."""
    progress = {
        name: replace(step, attempts={}, update=replace(step.update.pardoned(), quarantined={}, lifted=at))
        for name, at in asked.items()
        if (step := memory.of(name)).update.lifted != at
    }
    return replace(memory, progress=updated(memory.progress, progress)) if progress else memory


def pardoned(memory: Memory, desired: Desired, now: float) -> Memory:
    """Let changes be tried again that failed right before the engine stopped answering: their programs may have ended
    with it. A program that ends for good is not run again."""
    services = desired.catalog.services
    progress = {
        name: _pardoned(step)
        for name, step in memory.progress.items()
        if now - step.update.failed_at <= GOING and name in services and services[name].restart != "never"
    }
    return replace(memory, progress=updated(memory.progress, progress)) if progress else memory


def _pardoned(progress: Progress) -> Progress:
    """Count its last end as one that rorg asked for."""
    progress = progress.with_stopped(progress.exited) if progress.exited else progress
    update = progress.update.pardoned()
    return replace(progress, exits=0, exited="", attempts={}, error="", update=update)
