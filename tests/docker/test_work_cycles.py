"""0 times told ready and found something else: the short version. tests/bench/test_many_cycles.py plays thousands."""

from __future__ import annotations

import pytest
from cycle_robot import daemon, programs  # noqa: F401
from cycles import Restarts, cycle


@pytest.mark.slow
def test_programs_are_told_the_truth(daemon, programs):  # noqa: F811
    result = cycle(daemon, programs, 20 if daemon.robot.kind == "docker" else 60)
    assert not result.wrong
    assert not result.errors


@pytest.mark.slow
def test_programs_see_no_more_than_a_longer_wait_while_rorg_is_stopped_and_killed(daemon, programs):  # noqa: F811
    restarts = Restarts(daemon, every=25)
    result = cycle(daemon, programs, 20 if daemon.robot.kind == "docker" else 40, restarts)
    assert not result.wrong
    assert not result.errors
    assert restarts.count >= 2
