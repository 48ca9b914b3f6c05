"""The bound within which bounded worlds are explored completely, and the order of its worlds.

Complete means: in every world of each line, every sequence of up to so many steps of the alphabet (steps.py) that
begins with a request. After each step passes REST, or in one place of the sequence one of the pauses instead.
"""

from __future__ import annotations

import random
from collections.abc import Callable

from bounded.explore import Bound, Explorer, Tally
from bounded.worlds import worlds

BOUNDS = (
    Bound(services=2, features=1, steps=2, asked=True, pauses=(0.03,)),
    Bound(services=3, features=0, steps=2, asked=True, pauses=(0.03,)),
    Bound(services=1, features=1, steps=3, asked=True, pauses=(0.03,)),
    Bound(services=1, features=0, steps=6, asked=True, pauses=(0.03,)),
    Bound(services=4, features=0, steps=2, asked=True, pauses=(0.03,)),
    Bound(services=1, features=2, steps=3, asked=True, pauses=(0.03,)),
    Bound(services=2, features=2, steps=2, asked=True, pauses=(0.03,)),
    Bound(services=3, features=1, steps=2, asked=True, pauses=(0.03,)),
)
SLICE = (9, 4, 4, 1, 4, 1, 2, 2)
"""Worlds of each bound that a slice takes, and"""
SAMPLE = 7
"""steps that it takes of each of their states."""


def whole(say: Callable[[str], None]) -> Tally:
    """Explore all worlds within the bound, and say the counts of each line."""
    total = Tally()
    for bound in BOUNDS:
        tally = Tally()
        for world in worlds(bound.services, bound.features):
            Explorer(world, bound, tally).run()
        say(f"{bound.services} services, {bound.features} features, {bound.steps} steps: {tally}")
        total.add(tally)
    return total


def slice_of(seed: int, tally: Tally, share: float = 1.0) -> Tally:
    """Explore some worlds, and some steps in each, drawn by a seed. `share` takes fewer worlds."""
    for bound, count in zip(BOUNDS, SLICE, strict=True):
        drawn = random.Random(f"{seed} {bound}")
        known = list(worlds(bound.services, bound.features))
        for world in drawn.sample(known, min(len(known), max(1, round(count * share)))):
            Explorer(world, bound, tally, sample=SAMPLE, seed=seed).run()
    return tally
