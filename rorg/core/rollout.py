"""The trial of a new container: the one before it is kept until this one is ready and has stayed well for its bake;
else it is gone back to, and what failed is quarantined: not tried again until it is changed, or a person says so.

A new container carries the id of the one before it in a label, so whoever comes after a crash knows which is which.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from rorg.core.content import changed
from rorg.core.desired import Desired
from rorg.core.diff import difference
from rorg.core.memory import Memory, Progress
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
    asked = service.ready is not None and service.ready.delay is None
    return step.well_since if asked else step.well_since + min(TRIAL, service.update.bake)


def fits(container: Container, name: str, desired: Desired) -> bool:
    """It is what the manifest of its service says, as far as no new container would be needed."""
    if container.digest == desired.digests[name]:
        return True
    spec = desired.catalog.services[name].spec or {}
    return not difference(container, spec, desired.digests[name], desired.declared[name]).recreate


def renewed(step: Progress, edition: str) -> Progress:
    """A new edition of a service begins afresh: no back-off."""
    was = step.update
    if was.edition == edition:
        return step
    step = replace(step, update=replace(was, edition=edition))
    return replace(step, exits=0, attempts={}, error="") if was.edition else step


def judged(step: Progress, service: Service, desired: Desired, seen: Seen) -> Progress:
    """Takes note of a trial that is over, and of an edition that has stayed well. Only of a wanted service, and not
    while we act on it."""
    containers = seen.containers.get(service.name, ())
    if not containers or not seen.wanted or seen.busy or seen.unplugged or step.update.drawn:
        return step
    pair = candidate(containers, step.update) if len(containers) > 1 else None
    if pair is None:
        return _baked(step, service, containers[0], desired, seen.now)
    new, old = pair
    if old.alive and not new.alive and old.started_at > new.created_at:
        # Somebody went back already, and did not live to note it.
        passed, error = False, new.error or f"ended with exit code {new.exit_code}"
    else:
        passed, error = _found(step, service, containers[0], seen.now) if containers[0].id == new.id else (False, "")
    if passed:
        step = _baked(step, service, new, desired, seen.now)
        # Of a set nobody is proven before all are (see atomic.py).
        together = service.update.atomic in desired.sets
        return step if together else replace(step, update=replace(step.update, proven=new.id))
    return failed(step, error) if error and fits(new, service.name, desired) else step


def _found(step: Progress, service: Service, current: Container, now: float) -> tuple[bool, str]:
    """Whether a run has stayed well for its bake; or what is wrong with it."""
    if current.state == "exited" and step.exited == current.incarnation:
        done = current.exit_code == 0 and step.over(service, current)
        return done, "" if done else step.error
    if current.state != "running" or step.running_since is None or step.doubted_since is not None:
        return False, ""
    said = f": {step.probe}" if step.probe else ""
    if step.well_since is not None:
        return now >= step.well_since + service.update.bake, ""
    if step.hung == step.incarnation:
        return False, step.error
    if step.was_ready:
        return False, f"not ready any more{said}"
    limit = service.ready.timeout if service.ready and service.ready.delay is None else None
    late = limit is not None and now >= step.running_since + limit
    return False, f"not ready within {format_seconds(limit or 0.0)}{said}" if late else ""


def _baked(step: Progress, service: Service, current: Container, desired: Desired, now: float) -> Progress:
    update, name = step.update, service.name
    if update.baked == update.edition or not fits(current, name, desired) or not _found(step, service, current, now)[0]:
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
