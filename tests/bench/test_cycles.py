"""The long version of tests/test_cycles.py: CYCLES of each program (3400 by default; on Docker a tenth), printed."""

from __future__ import annotations

import os

import pytest
from cycles import Restarts, cycle
from test_cycles import daemon, programs  # noqa: F401

CYCLES = int(os.environ.get("CYCLES", "3400"))


@pytest.mark.parametrize("restarts", [False, True])
def test_cycles(daemon, programs, restarts):  # noqa: F811
    count = CYCLES // (10 if daemon.robot.kind == "docker" else 1) // (5 if restarts else 1)
    ends = Restarts(daemon, every=30)
    result = cycle(daemon, programs, count, ends if restarts else lambda _: None)
    print(f"\n{daemon.robot.kind}: {result.cycles} cycles, {len(result.wrong)} wrong, {len(result.errors)} errors, "
          f"longest {result.longest:.1f} s, {ends.count if restarts else 0} restarts of rorg")
    assert not result.wrong
    assert not result.errors
