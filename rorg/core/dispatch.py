"""Which actions of a plan to begin now, so that an action a request waits for never queues behind bulk work."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import chain, islice

from rorg.core.memory import InFlight
from rorg.core.plan import Action

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
