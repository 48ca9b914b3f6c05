"""Which actions of a plan to begin now, so that an action a request waits for never queues behind bulk work; and how
the loop's memory changes when actions begin and end."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain, islice

from rorg.core.changes import updated
from rorg.core.digest import canonical
from rorg.core.memory import STALLED_AFTER, Attempt, InFlight, Memory, Progress, delay
from rorg.core.observed import Container, Observed
from rorg.core.operations import Remove, Signal, Start, Stop
from rorg.core.plan import Action
from rorg.core.rollout import refused

STUCK = 5.0
"""Seconds after which a call counts as blocked rather than as load. It then frees its slot."""


@dataclass(frozen=True, slots=True)
class DispatchLimits:
    """Concurrent engine calls: for urgent work, for bulk work, and in total (blocked ones included).

    Two bulk calls at a time because more of them slow down what a person waits for: measured on two cores, the median
    from unpause to answer is 22 ms beside 2 bulk workers and 42 ms beside 8.
    """

    urgent: int = 8
    bulk: int = 2
    most: int = 64

    def allowing(self, bulk: int | None) -> DispatchLimits:
        """Return these limits with another number of bulk calls, if one is given."""
        return self if bulk is None else replace(self, bulk=bulk)


def select(
    ready: Iterable[Action], in_flight: Mapping[str, InFlight], limits: DispatchLimits, now: float
) -> list[Action]:
    """Return the actions to begin. `ready` are actions that follow nothing, sorted: urgent ones, then drivers, then by
    priority."""
    busy = [f.action for f in in_flight.values() if now - f.since < STUCK]
    slots = {
        True: limits.urgent - sum(a.urgent for a in busy),
        False: limits.bulk - sum(not a.urgent for a in busy),
    }
    ready = iter(ready)
    first = [*islice(ready, 1)]
    if any(a.urgent for a in (*busy, *first)):
        # Measured: an urgent call takes three times as long beside two bulk calls as beside one.
        slots[False] = min(slots[False], 1 - sum(not a.urgent for a in busy))
    remaining = limits.most - len(in_flight)
    chosen: list[Action] = []
    for action in chain(first, ready):
        if remaining <= 0 or (slots[False] <= 0 and (not action.urgent or slots[True] <= 0)):
            break
        if slots[action.urgent] > 0:
            slots[action.urgent] -= 1
            remaining -= 1
            chosen.append(action)
    return chosen


def freed_at(in_flight: Mapping[str, InFlight], now: float) -> float | None:
    """Return when the next call under way begins to count as blocked; None if there is none."""
    times = [f.since + STUCK for f in in_flight.values() if f.since + STUCK > now]
    return min(times, default=None)


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
    unanswered: bool = False
    """The engine did not answer, or ended the connection; a call that times out hangs for a reason of its own."""


def forget(memory: Memory, names: Iterable[str], busy: Collection[str]) -> Memory:
    """Forget failed attempts of services for which nothing is left to do. `busy` are those of `names` with work
    left."""
    done = {
        name: replace(progress, attempts={}, removals={}, error=progress.error if progress.exits else "")
        for name in names
        if ((progress := memory.of(name)).attempts or progress.removals)
        and name not in busy
        and name not in memory.in_flight
    }
    return replace(memory, progress=updated(memory.progress, done)) if done else memory


def begin(memory: Memory, actions: Sequence[Action], observed: Observed, now: float) -> Memory:
    """Note that workers have these actions: their services get no second action before the outcome."""
    if not actions:
        return memory
    there = observed.by_service()
    begun = {a.service: _begun(memory.of(a.service), a, there.get(a.service, ())) for a in actions}
    flights = {a.service: InFlight(a, now) for a in actions}
    return replace(memory, progress=updated(memory.progress, begun), in_flight={**memory.in_flight, **flights})


def _begun(progress: Progress, action: Action, containers: Sequence[Container]) -> Progress:
    state = canonical([(c.id, c.state, c.name, c.incarnation, c.live) for c in containers])
    operation = action.operation
    signature = (operation.container, operation.attempted, state)
    before = progress.attempt(operation) or Attempt()
    count = before.count + 1 if signature == before.signature else 1
    progress = progress.attempting(operation, replace(before, signature=signature, count=count))
    if progress.removals:
        there = {c.id for c in containers}
        progress = replace(progress, removals={id: tried for id, tried in progress.removals.items() if id in there})
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
    progress, in_flight = dict[str, Progress](), {**memory.in_flight}
    for outcome in outcomes:
        name = outcome.action.service
        in_flight.pop(name, None)
        step = _finished(progress.get(name) or memory.of(name), outcome, now)
        progress[name] = refused(step, outcome.action, outcome.error, now) if outcome.refused else step
    return replace(memory, progress=updated(memory.progress, progress), in_flight=in_flight)


def _finished(progress: Progress, outcome: Outcome, now: float) -> Progress:
    operation, error = outcome.action.operation, outcome.error
    attempt = progress.attempt(operation) or Attempt()
    if error or attempt.count >= STALLED_AFTER:
        attempt = replace(attempt, at=now + delay(attempt.count + 1), error=error)
        attempt = replace(attempt, missing=outcome.missing, spent=outcome.spent, unsupported=outcome.unsupported)
        attempt = replace(attempt, unanswered=outcome.unanswered)
        progress = progress.attempting(operation, attempt)
        progress = progress if isinstance(operation, Remove) else replace(progress, error=error)
    elif attempt.error and not progress.exits:
        attempt = replace(attempt, at=0.0, error="", missing=False, spent=False, unsupported=False, unanswered=False)
        progress = progress.attempting(operation, attempt)
        progress = replace(progress, error=next((t.error for t in progress.attempts.values() if t.error), ""))
    if isinstance(operation, Signal) and not error and progress.update.run == operation.incarnation:
        progress = replace(progress, update=replace(progress.update, content=operation.content, since=now))
    return replace(progress, begun=None) if isinstance(operation, Start) and error else progress
