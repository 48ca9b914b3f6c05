"""The trial of a new container: the one before it is kept until this one runs, and is ready where that is asked; else
it is gone back to, and what failed is not tried again until it is changed.

A new container carries the id of the one before it in a label, so whoever comes after a crash knows which is which.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from rorg.core.desired import Desired
from rorg.core.diff import difference
from rorg.core.memory import Progress
from rorg.core.observed import Container
from rorg.core.plan import Action
from rorg.core.seen import Seen
from rorg.core.update import Update
from rorg.model.catalog import Service
from rorg.model.units import format_seconds

TRIAL = 2.0
"""Seconds without an end that prove a service which does not say when it is ready."""


def candidate(containers: Sequence[Container], update: Update) -> tuple[Container, Container] | None:
    """(the new container, the one before it), while the new one is not proven."""
    known = {c.id: c for c in containers}
    return next(((c, known[c.previous]) for c in containers if c.previous in known and c.id != update.proven), None)


def patience(service: Service) -> float:
    """Seconds of running after which the trial ends, one way or the other."""
    if service.ready is None:
        return TRIAL
    return service.ready.timeout if service.ready.delay is None else max(TRIAL, service.ready.delay)


def asks(service: Service) -> bool:
    """Whether its readiness is asked for, rather than a matter of time."""
    return service.ready is not None and service.ready.kind != "delay"


def renewed(step: Progress, edition: str) -> Progress:
    """A new edition of a service begins afresh: no back-off, nothing that failed."""
    was = step.update
    if was.edition == edition:
        return step
    kept = was if was.failed == edition else replace(was, failed="", error="")
    step = replace(step, update=replace(kept, edition=edition))
    return replace(step, exits=0, attempts={}, error="") if was.edition else step


def judged(step: Progress, service: Service, desired: Desired, seen: Seen) -> Progress:
    """Takes note of a trial that is over. Only of a wanted service, and not while we act on it."""
    containers = seen.containers.get(service.name, ())
    pair = candidate(containers, step.update) if len(containers) > 1 and seen.wanted and not seen.busy else None
    return step if pair is None else _judge(step, service, desired, containers[0], pair, seen.now)


def _judge(
    step: Progress,
    service: Service,
    desired: Desired,
    current: Container,
    pair: tuple[Container, Container],
    now: float,
) -> Progress:
    new, old = pair
    spec, name = service.spec or {}, service.name
    counts = not difference(new, spec, desired.digests[name], desired.declared[name]).recreate
    error, passed = "", False
    if old.alive and not new.alive and old.started_at > new.created_at:
        # Somebody went back already, and did not live to note it.
        error = new.error or f"ended with exit code {new.exit_code}"
    elif current.id == new.id and new.state == "exited" and step.exited == new.incarnation:
        passed = new.exit_code == 0 and step.over(service, new)
        error = "" if passed else step.error
    elif current.id == new.id and new.state == "running" and step.running_since is not None:
        late = now >= step.running_since + patience(service)
        passed = step.ready and (late or asks(service))
        error = (
            f"not ready within {format_seconds(patience(service))}" + (f": {step.probe}" if step.probe else "")
            if late and not passed
            else ""
        )
    if passed:
        return replace(step, update=replace(step.update, proven=new.id))
    return _failed(step, error) if error and counts else step


def _failed(step: Progress, error: str) -> Progress:
    if step.update.failed == step.update.edition:
        return step
    return replace(
        step, exits=0, attempts={}, error="", update=replace(step.update, failed=step.update.edition, error=error)
    )


def refused(step: Progress, action: Action, error: str) -> Progress:
    """The engine refused an action for what was asked, not for want of an answer."""
    return _failed(step, error) if action.verb == "start" and action.args.get("trial") == step.update.edition else step
