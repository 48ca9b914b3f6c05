"""The trial of a new container: the one before it is kept until this one is ready and has stayed well for its bake;
else it is gone back to, and what failed is quarantined: not tried again until it is changed, or a person says so.

A new container carries the id of the one before it in a label, so whoever comes after a crash knows which is which.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from rorg.core.content import changed
from rorg.core.desired import Desired
from rorg.core.diff import difference
from rorg.core.memory import NO_ANSWER, Memory, ProbeResult, Progress
from rorg.core.observed import Container
from rorg.core.operations import Start
from rorg.core.plan import Action
from rorg.core.seen import Seen
from rorg.core.update import Update
from rorg.model.catalog import Service
from rorg.model.units import format_seconds

TRIAL = 2.0
"""Seconds of running after which a service that does not say when it is ready has come up."""


def candidate(containers: Sequence[Container], update: Update) -> tuple[Container, Container] | None:
    """(the new container, the one before it), while the new one is not proven."""
    known = {c.id: c for c in containers}
    return next(((c, known[c.previous]) for c in containers if c.previous in known and c.id != update.proven), None)


def came_up_at(step: Progress, service: Service) -> float | None:
    """When a run has come up, so that others may count on it: once it is ready, where it is asked for that; else after
    a moment of running, and never later than its bake ends. None while it is not ready."""
    if step.well_since is None:
        return None
    return step.well_since if _is_asked(service) else step.well_since + min(TRIAL, service.update.bake)


def has_come_up(step: Progress, service: Service, looked: float | None, now: float) -> bool:
    """Whether others may count on a run. Where no probe has told, a look at its container must have begun since;
    `looked` is when the last one did."""
    up = came_up_at(step, service)
    return up is not None and up <= now and (_is_asked(service) or (looked is not None and looked >= up))


def _is_asked(service: Service) -> bool:
    """Whether a probe tells that it is ready, rather than the clock."""
    return service.ready is not None and service.ready.delay is None


def fits(container: Container, name: str, desired: Desired) -> bool:
    """It is what the manifest of its service says, as far as no new container would be needed."""
    if container.digest == desired.digests[name]:
        return True
    spec = desired.catalog.services[name].spec or {}
    return not difference(container, spec, desired.digests[name], desired.declared[name]).recreate


def renewed(step: Progress, edition: str, now: float) -> Progress:
    """A new edition of a service begins afresh: no back-off, and its probes are asked again."""
    was = step.update
    if was.edition == edition:
        return step
    if not was.edition:
        return replace(step, update=replace(was, edition=edition))
    return replace(step, exits=0, attempts={}, error="", update=replace(was, edition=edition, since=now))


@dataclass(frozen=True, slots=True)
class _Verdict:
    """On a run. One that is neither passed nor has an error is open: for want of time, or, with `since`, of a look at
    its container and of answers of its probes that began after that moment."""

    passed: bool = False
    error: str = ""
    since: float | None = None


_OPEN = _Verdict()


def judged(step: Progress, service: Service, desired: Desired, seen: Seen) -> Progress:
    """Takes note of a trial that is over, and of an edition that has stayed well. Only of a wanted service, and not
    while we act on it."""
    containers = seen.containers.get(service.name, ())
    if not containers or not seen.wanted or seen.busy or seen.unplugged or step.update.drawn:
        return _awaiting(step, None)
    pair = candidate(containers, step.update) if len(containers) > 1 else None
    if pair is None:
        return _judged_alone(step, service, containers[0], desired, seen)
    new, old = pair
    verdict = _OPEN
    if old.alive and not new.alive and old.started_at > new.created_at:
        # Somebody went back already, and did not live to note it.
        verdict = _Verdict(error=new.error or f"ended with exit code {new.exit_code}")
    elif containers[0].id == new.id:
        verdict = _verdict(step, service, new, seen)
        up = came_up_at(step, service)
        if verdict == _OPEN and up is not None and up <= seen.now and not _is_asked(service):
            verdict = _Verdict(since=up)  # others may count on it from then on
    step = _awaiting(step, verdict.since)
    if verdict.passed:
        step = _baked(step, service, new, desired)
        # Of a set nobody is proven before all are (see atomic.py).
        together = service.update.atomic in desired.sets
        return step if together else replace(step, update=replace(step.update, proven=new.id))
    return failed(step, verdict.error) if verdict.error and fits(new, service.name, desired) else step


def _judged_alone(step: Progress, service: Service, current: Container, desired: Desired, seen: Seen) -> Progress:
    """Of a service with nothing to go back to. Where its probes have changed, and its container has not, these decide:
    one that does not say yes to them is not ready."""
    update = step.update
    if update.baked == update.edition or not fits(current, service.name, desired):
        return _awaiting(step, None)
    verdict = _verdict(step, service, current, seen)
    step = _awaiting(step, verdict.since)
    if verdict.passed:
        return _baked(step, service, current, desired)
    goes_on = step.running_since is not None and step.hung != step.incarnation
    if verdict.error and goes_on and update.since > (step.running_since or 0.0) and not update.failed:
        return replace(failed(step, verdict.error), ready=False, was_ready=False, well_since=None)
    return step


def _awaiting(step: Progress, since: float | None) -> Progress:
    return step if step.unproven_since == since else replace(step, unproven_since=since)


def _verdict(step: Progress, service: Service, current: Container, seen: Seen) -> _Verdict:
    """Whether a run has stayed well for its bake; or what is wrong with it."""
    if current.state == "exited" and step.exited == current.incarnation:
        done = current.exit_code == 0 and step.over(service, current)
        return _Verdict(passed=True) if done else _Verdict(error=step.error)
    if current.state != "running" or step.running_since is None or step.doubted_since is not None:
        return _OPEN
    if step.well_since is not None:
        return _of_a_bake(step, service, current, seen)
    if step.hung == step.incarnation:
        return _Verdict(error=step.error or NO_ANSWER)
    said = f": {step.probe}" if step.probe else ""
    if step.was_ready:
        return _Verdict(error=f"not ready any more{said}")
    late_at = is_late_at(step, service)
    if late_at is None or seen.now < late_at:
        return _OPEN
    told = seen.looked_since(current, late_at) and _answers(step, service, seen, late_at) is not None
    return _Verdict(error=_not_ready(service, said)) if told else _Verdict(since=late_at)


def bake_ends_at(step: Progress, service: Service) -> float | None:
    """When a run has been well for its bake, if it goes on like this; not before its edition was declared."""
    return None if step.well_since is None else max(step.well_since + service.update.bake, step.update.since)


def is_late_at(step: Progress, service: Service) -> float | None:
    """When a run that does not say that it is ready, as it is to be asked now, has had the time for it."""
    if step.running_since is None or service.ready is None or not _is_asked(service):
        return None
    since = bake_ends_at(step, service)
    return (max(step.running_since, step.update.since) if since is None else since) + service.ready.timeout


def _of_a_bake(step: Progress, service: Service, current: Container, seen: Seen) -> _Verdict:
    """Of a run that is well as far as is known. One that does not answer `ready` any more has its timeout to do so."""
    over = bake_ends_at(step, service)
    if over is None or seen.now < over:
        return _OPEN
    answers = _answers(step, service, seen, over)
    if answers is None or not seen.looked_since(current, over):
        return _Verdict(since=over)
    if all(found.ok for found in answers):
        return _Verdict(passed=True)
    late_at, found = is_late_at(step, service), seen.ready
    late = late_at is not None and seen.now >= late_at and found is not None and not found.ok and found.failures
    return _Verdict(error=_not_ready(service, f": {found.message}")) if late and found else _Verdict(since=over)


def _answers(step: Progress, service: Service, seen: Seen, since: float) -> Sequence[ProbeResult] | None:
    """What the probes of a run have said that were asked since; None while one of them has not."""
    asked = [seen.ready] if _is_asked(service) else []
    asked += [seen.live] if service.live is not None and step.was_ready else []
    found = [a for a in asked if a is not None and a.incarnation == step.incarnation and a.at >= since]
    return found if len(found) == len(asked) else None


def _not_ready(service: Service, said: str) -> str:
    return f"not ready within {format_seconds(service.ready.timeout if service.ready else 0.0)}{said}"


def _baked(step: Progress, service: Service, current: Container, desired: Desired) -> Progress:
    """With its edition noted as one that has stayed well."""
    update, name = step.update, service.name
    if update.baked == update.edition or not fits(current, name, desired):
        return step
    if service.on_change != "none" and changed(update, current, desired.contents.get(name, {})):
        return step  # this run has not read what is there
    return replace(step, update=replace(update, baked=update.edition))


def failed(step: Progress, error: str) -> Progress:
    """With the edition that is desired in quarantine. What there is to go back to begins afresh."""
    if step.update.edition in step.update.quarantined:
        return step
    return replace(step, exits=0, attempts={}, error="", update=step.update.quarantine(error))


def refused(step: Progress, action: Action, error: str) -> Progress:
    """The engine refused an action for what was asked, not for want of an answer."""
    operation = action.operation
    tried = operation.trial if isinstance(operation, Start) else ""
    return failed(step, error) if tried and tried == step.update.edition else step


def retried(memory: Memory, asked: Mapping[str, str]) -> Memory:
    """With the quarantine of these services lifted, each once for each time at which that was asked for."""
    progress = {
        name: replace(step, attempts={}, update=replace(step.update, quarantined={}, lifted=at))
        for name, at in asked.items()
        if (step := memory.of(name)).update.lifted != at
    }
    return replace(memory, progress={**memory.progress, **progress}) if progress else memory
