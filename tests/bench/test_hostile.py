"""How much later a person's request is acted on while a service floods the server: at most twice as late."""

from __future__ import annotations

from statistics import median

import pytest
from floods import FLOODS
from limited_server import beside, robot  # noqa: F401


@pytest.mark.parametrize("kind", FLOODS)
def test_a_flood_costs_others_at_most_as_much_again(robot, kind):  # noqa: F811
    quiet, loud = beside(robot, kind, rounds=5, each=30)
    print(f"\n{kind}: {median(quiet) * 1000:.0f} ms, beside it {median(loud) * 1000:.0f} ms")
    assert median(loud) < 2 * median(quiet)
