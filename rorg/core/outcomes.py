"""How the loop's memory changes when actions begin and end."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

from rorg.core.digest import canonical
from rorg.core.memory import STALLED_AFTER, Attempt, InFlight, Memory, Progress, delay
from rorg.core.observed import Container, Observed
from rorg.core.operations import Signal, Start, Stop
from rorg.core.plan import Action
from rorg.core.rollout import refused


@dataclass(frozen=True, slots=True)
class Outcome:
    """The result of an action."""

    action: Action
    error: str = ""
    """"" if it succeeded."""
    refused: bool = False
    """The engine refused the call, rather than not answering it."""
    missing: bool = False
    """The image or program is not on this machine."""
    spent: bool = False
    """The engine will never start this container again."""
    unsupported: bool = False
    """The engine does not support the operation."""


def forget(memory: Memory, names: Iterable[str], busy: Collection[str]) -> Memory:
    """Forget failed attempts of services for which nothing is left to do. `busy` are those of `names` with work
    left."""
    done = {
        name: replace(progress, attempts={}, error=progress.error if progress.exits else "")
        for name in names
        if (progress := memory.of(name)).attempts and name not in busy and name not in memory.in_flight
    }
    return replace(memory, progress={**memory.progress, **done}) if done else memory


def begin(memory: Memory, actions: Sequence[Action], observed: Observed, now: float) -> Memory:
    """Note that workers have these actions: their services get no second action before the outcome."""
    if not actions:
        return memory
    there = observed.by_service()
    begun = {a.service: _begun(memory.of(a.service), a, there.get(a.service, ())) for a in actions}
    flights = {a.service: InFlight(a, now) for a in actions}
    return replace(memory, progress={**memory.progress, **begun}, in_flight={**memory.in_flight, **flights})


def _begun(progress: Progress, action: Action, containers: Sequence[Container]) -> Progress:
    state = canonical([(c.id, c.state, c.name, c.incarnation, c.live) for c in containers])
    operation = action.operation
    signature = (operation.container, operation.attempted, state)
    before = progress.attempt(operation) or Attempt()
    count = before.count + 1 if signature == before.signature else 1
    progress = progress.attempting(operation, replace(before, signature=signature, count=count))
    if isinstance(operation, Start):
        progress = replace(
            progress, begun=operation.counts_on, update=replace(progress.update, begun=operation.content)
        )
    if isinstance(operation, Stop):
        # Note it before the call: if rorg is killed now, its next run must still know that this exit is no crash.
        progress = progress.with_stopped(operation.incarnation)
    return progress


def finish(memory: Memory, outcomes: Iterable[Outcome], now: float) -> Memory:
    """Note the outcomes of actions."""
    progress, in_flight = {**memory.progress}, {**memory.in_flight}
    for outcome in outcomes:
        name = outcome.action.service
        in_flight.pop(name, None)
        step = _finished(progress.get(name, Progress()), outcome, now)
        progress[name] = refused(step, outcome.action, outcome.error) if outcome.refused else step
    return replace(memory, progress=progress, in_flight=in_flight)


def _finished(progress: Progress, outcome: Outcome, now: float) -> Progress:
    operation, error = outcome.action.operation, outcome.error
    attempt = progress.attempt(operation) or Attempt()
    if error or attempt.count >= STALLED_AFTER:
        attempt = replace(attempt, at=now + delay(attempt.count + 1), error=error)
        attempt = replace(attempt, missing=outcome.missing, spent=outcome.spent, unsupported=outcome.unsupported)
        progress = replace(progress.attempting(operation, attempt), error=error)
    elif attempt.error and not progress.exits:
        attempt = replace(attempt, at=0.0, error="", missing=False, spent=False, unsupported=False)
        progress = progress.attempting(operation, attempt)
        progress = replace(progress, error=next((t.error for t in progress.attempts.values() if t.error), ""))
    if isinstance(operation, Signal) and not error and progress.update.run == operation.incarnation:
        progress = replace(progress, update=replace(progress.update, content=operation.content))
    return replace(progress, begun=None) if isinstance(operation, Start) and error else progress
