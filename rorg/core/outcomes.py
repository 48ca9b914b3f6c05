"""How the loop's memory changes with what is done: actions that are begun, their outcomes, attempts that are over."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

from rorg.core.backoff import STALLED_AFTER, delay
from rorg.core.digest import canonical
from rorg.core.memory import Attempt, InFlight, Memory, Progress
from rorg.core.observed import Container, Observed
from rorg.core.operations import Signal, Start, Stop
from rorg.core.plan import Action
from rorg.core.rollout import refused


@dataclass(frozen=True, slots=True)
class Outcome:
    """What came of an action."""

    action: Action
    error: str = ""
    """Empty when it went well."""
    refused: bool = False
    """The engine said no to what was asked, rather than that it gave no answer."""
    missing: bool = False
    """The image, or the program, is not on this machine."""
    spent: bool = False
    """The engine will never start that container again."""
    unsupported: bool = False
    """The engine cannot do that at all."""


def forget(memory: Memory, names: Iterable[str], busy: Collection[str]) -> Memory:
    """Failed attempts of those of these services for which there is nothing to do any more. `busy` are all others."""
    done = {
        name: replace(step, attempts={}, error=step.error if step.exits else "")
        for name in names
        if (step := memory.of(name)).attempts and name not in busy and name not in memory.in_flight
    }
    return replace(memory, progress={**memory.progress, **done}) if done else memory


def begin(memory: Memory, actions: Sequence[Action], observed: Observed, now: float) -> Memory:
    """Actions are handed to workers: their services get no second one until the outcome."""
    if not actions:
        return memory
    there = observed.by_service()
    begun = {a.service: _begun(memory.of(a.service), a, there.get(a.service, ())) for a in actions}
    flights = {a.service: InFlight(a, now) for a in actions}
    return replace(memory, progress={**memory.progress, **begun}, in_flight={**memory.in_flight, **flights})


def _begun(step: Progress, action: Action, containers: Sequence[Container]) -> Progress:
    state = canonical([(c.id, c.state, c.name, c.incarnation, c.live) for c in containers])
    operation = action.operation
    signature = (operation.container, operation.attempted, state)
    before = step.attempt(operation) or Attempt()
    count = before.count + 1 if signature == before.signature else 1
    step = step.attempting(operation, replace(before, signature=signature, count=count))
    if isinstance(operation, Start):
        step = replace(step, begun=operation.counts_on, update=replace(step.update, begun=operation.content))
    if isinstance(operation, Stop):
        # From now on its end is our doing, even if this rorg does not live to see it.
        step = step.with_stopped(operation.incarnation)
    return step


def finish(memory: Memory, outcomes: Iterable[Outcome], now: float) -> Memory:
    """What came of actions."""
    progress, in_flight = {**memory.progress}, {**memory.in_flight}
    for outcome in outcomes:
        name = outcome.action.service
        in_flight.pop(name, None)
        step = _finished(progress.get(name, Progress()), outcome, now)
        progress[name] = refused(step, outcome.action, outcome.error) if outcome.refused else step
    return replace(memory, progress=progress, in_flight=in_flight)


def _finished(step: Progress, outcome: Outcome, now: float) -> Progress:
    operation, error = outcome.action.operation, outcome.error
    tried = step.attempt(operation) or Attempt()
    if error or tried.count >= STALLED_AFTER:
        tried = replace(tried, at=now + delay(tried.count + 1), error=error)
        tried = replace(tried, missing=outcome.missing, spent=outcome.spent, unsupported=outcome.unsupported)
        step = replace(step.attempting(operation, tried), error=error)
    elif tried.error and not step.exits:
        tried = replace(tried, at=0.0, error="", missing=False, spent=False, unsupported=False)
        step = step.attempting(operation, tried)
        step = replace(step, error=next((t.error for t in step.attempts.values() if t.error), ""))
    if isinstance(operation, Signal) and not error and step.update.run == operation.incarnation:
        step = replace(step, update=replace(step.update, content=operation.content))
    return replace(step, begun=None) if isinstance(operation, Start) and error else step
