"""Which of a plan's actions to begin now, so that what a request waits for never queues behind bulk work."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import chain, islice

from rorg.core.memory import InFlight
from rorg.core.plan import Action

STUCK = 5.0
"""Seconds after which a call counts as waiting for something, not as load; it no longer takes a place."""


@dataclass(frozen=True, slots=True)
class DispatchLimits:
    """Engine calls at once: for what requests wait for, for everything else, and in all (stuck ones included)."""

    urgent: int = 8
    bulk: int = 2
    most: int = 64

    def allowing(self, bulk: int | None) -> DispatchLimits:
        """With so much bulk work at once, where it is said."""
        return self if bulk is None else replace(self, bulk=bulk)


def select(
    ready: Iterable[Action], in_flight: Mapping[str, InFlight], limits: DispatchLimits, now: float
) -> list[Action]:
    """Actions to begin now. `ready` are those that follow nothing, urgent ones first, then drivers, then the higher
    priority."""
    busy = [f.action for f in in_flight.values() if now - f.since < STUCK]
    room = {
        True: limits.urgent - sum(a.urgent for a in busy),
        False: limits.bulk - sum(not a.urgent for a in busy),
    }
    ready = iter(ready)
    first = [*islice(ready, 1)]
    if any(a.urgent for a in (*busy, *first)):
        # What somebody waits for takes three times as long beside two calls of bulk work as beside one.
        room[False] = min(room[False], 1 - sum(not a.urgent for a in busy))
    left = limits.most - len(in_flight)
    chosen: list[Action] = []
    for action in chain(first, ready):
        if left <= 0 or (room[False] <= 0 and (not action.urgent or room[True] <= 0)):
            break
        if room[action.urgent] > 0:
            room[action.urgent] -= 1
            left -= 1
            chosen.append(action)
    return chosen


def freed_at(in_flight: Mapping[str, InFlight], now: float) -> float | None:
    """When the next call under way begins to count as stuck, which frees its place; None without one."""
    times = [f.since + STUCK for f in in_flight.values() if f.since + STUCK > now]
    return min(times, default=None)
