"""The trial of a new container: the one before it is kept until this one runs, and is ready where that is asked; else
it is gone back to, and what failed is not tried again until it is changed.

A new container carries the id of the one before it in a label, so whoever comes after a crash knows which is which.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from rorg.core.desired import Desired
from rorg.core.diff import difference
from rorg.core.memory import Memory, Progress
from rorg.core.observed import Container, Observed
from rorg.core.plan import Action
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


def renew(memory: Memory, editions: Mapping[str, str]) -> Memory:
    """A new edition of a service begins afresh: no back-off, nothing that failed."""
    progress = dict(memory.progress)
    for name, edition in editions.items():
        step = memory.of(name)
        was = step.update
        if was.edition == edition:
            continue
        kept = was if was.failed == edition else replace(was, failed="", error="")
        step = replace(step, update=replace(kept, edition=edition))
        progress[name] = replace(step, exits=0, attempts={}, error="") if was.edition else step
    return memory if progress == memory.progress else replace(memory, progress=progress)


def try_out(memory: Memory, desired: Desired, wanted: Collection[str], observed: Observed, now: float) -> Memory:
    """Takes note of trials that are over. Only of wanted services, and not while we act on them."""
    if not observed.complete:
        return memory
    progress = dict(memory.progress)
    for name, containers in observed.by_service().items():
        service, step = desired.catalog.services.get(name), memory.of(name)
        pair = candidate(containers, step.update) if len(containers) > 1 else None
        if service is None or pair is None or name not in wanted or name in memory.in_flight:
            continue
        progress[name] = _judge(step, service, desired, containers[0], pair, now)
    return replace(memory, progress=progress) if progress != memory.progress else memory


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


def refuse(memory: Memory, action: Action, error: str) -> Memory:
    """The engine refused an action for what was asked, not for want of an answer."""
    step = memory.of(action.service)
    if action.verb != "start" or action.args.get("trial") != step.update.edition:
        return memory
    return replace(memory, progress={**memory.progress, action.service: _failed(step, error)})
