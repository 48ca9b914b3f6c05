"""Kills rorg at a few of its effects, in some scenarios that the seed draws; at all of them by `make proof`. A failure
names its case."""

from __future__ import annotations

import os
import random
import time

import pytest
from proof.cases import Player
from proof.effects import SIDES
from proof.scenarios import ALL

DRAWN = 7
"""Scenarios of a run."""
BUDGET = float(os.environ.get("RORG_PROOF_BUDGET") or 0.5)
"""Seconds for the points of a scenario, beyond the first ones."""


def last_answer(player: Player) -> list[tuple[int, str]]:
    """The moment at which a client believes that its change is safe, with a loss of power."""
    numbers = [n for n, what in enumerate(player.effects, 1) if " answer " in what]
    return [(number, SIDES[-1]) for number in numbers[-1:]]


@pytest.mark.slow
@pytest.mark.parametrize("number", range(DRAWN))
def test_nothing_is_lost_at_any_point(number, tmp_path, request):
    seed = request.config.getoption("hypothesis_seed")
    name = random.Random(str(seed)).sample(sorted(ALL), DRAWN)[number]
    player = Player(ALL[name], tmp_path)
    try:
        points = list(player.points())
        random.Random(f"{seed} {name}").shuffle(points)
        points = [*last_answer(player), *points]
        until = time.monotonic() + BUDGET
        while points:
            result = player.play(*points.pop(0))
            assert not result.violations, f"RORG_TEST_SEED={seed} {result}"
            if time.monotonic() > until:
                break
    finally:
        player.close()


FOUND = {
    "a killed prune leaves no record of an image that is gone": ("prune", "engine remove_image"),
    "a build that is killed before its end is on record": ("image-build", "engine build_image"),
}
"""Points at which there was a violation: right after this effect of this scenario."""


@pytest.mark.slow
@pytest.mark.parametrize("found", FOUND)
def test_what_was_found_stays_mended(found, tmp_path):
    name, effect = FOUND[found]
    player = Player(ALL[name], tmp_path)
    try:
        number = next(n for n, what in enumerate(player.effects, 1) if effect in what)
        result = player.play(number, "after")
        assert not result.violations, str(result)
    finally:
        player.close()
