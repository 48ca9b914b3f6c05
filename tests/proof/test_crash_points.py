"""Kills rorg at a few of its effects, in some scenarios that the seed draws; at all of them by `make proof`. A failure
names its case."""

from __future__ import annotations

import os
import random
import time

import pytest
from cases import Player
from effects import SIDES
from scenarios import ALL

DRAWN = 7
"""Scenarios of a run."""
BUDGET = float(os.environ.get("RORG_PROOF_BUDGET") or 0.5)
"""Seconds for the points of a scenario, beyond the first ones."""


def last_answer(player: Player) -> list[tuple[int, str]]:
    """The moment at which a client believes that its change is safe, with a loss of power."""
    numbers = [n for n, what in enumerate(player.effects, 1) if " answer " in what]
    return [(number, SIDES[-1]) for number in numbers[-1:]]


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


def test_a_killed_prune_leaves_no_record_of_an_image_that_is_gone(tmp_path):
    player = Player(ALL["prune"], tmp_path)
    try:
        number = next(n for n, what in enumerate(player.effects, 1) if "engine remove_image" in what)
        assert player.play(number, "after").violations == []
    finally:
        player.close()
