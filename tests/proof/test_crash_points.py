"""Kills rorg at a sample of its effects, in every scenario; all of them by `make proof`. A failure names its case."""

from __future__ import annotations

import os
import random
import time

import pytest
from cases import Player
from effects import SIDES
from scenarios import SCENARIOS

BUDGET = float(os.environ.get("RORG_PROOF_BUDGET") or 1.2)
"""Seconds for the points of a scenario, beyond the first one."""


@pytest.mark.parametrize("name", SCENARIOS)
def test_nothing_is_lost_at_any_point(name, tmp_path, request):
    chance = random.Random(f"{request.config.getoption('hypothesis_seed')} {name}")
    player = Player(SCENARIOS[name], tmp_path)
    try:
        points, until = list(player.points()), time.monotonic() + BUDGET
        chance.shuffle(points)
        while points:
            result = player.play(*points.pop())
            assert not result.violations, str(result)
            if time.monotonic() > until:
                break
    finally:
        player.close()


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("request", "PUT"),
        ("release", "DELETE"),
        ("manifest-put", "PUT"),
        ("manifest-delete", "DELETE"),
        ("hold", "PUT"),
    ],
)
def test_what_was_acknowledged_survives_a_loss_of_power(name, told, tmp_path):
    player = Player(SCENARIOS[name], tmp_path)
    try:
        number = 1 + next(n for n, what in enumerate(player.effects) if f" answer {told} " in what)
        for side in SIDES[1:]:
            result = player.play(number, side)
            assert not result.violations, str(result)
    finally:
        player.close()
