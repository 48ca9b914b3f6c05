"""The last resort against mutants: the small worlds of `bounded`, with all their invariants, a second each at most."""

from __future__ import annotations

import pytest
from bounded.explore import Bound, Explorer, Tally
from bounded.worlds import World, worlds

BOUND = Bound(services=2, features=1, steps=2, asked=True, pauses=(0.05,))


@pytest.mark.parametrize("world", [*worlds(2, 1)], ids=lambda world: world.label.replace(" ", "_"))
def test_a_small_world_keeps_every_promise(world: World):
    tally = Tally()
    Explorer(world, BOUND, tally, sample=2, seed=1, first=True).run()
    assert not tally.found, str(tally.found[0])
