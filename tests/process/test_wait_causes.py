"""Commands that wait tell the root cause of many services once."""

from __future__ import annotations

import re

import pytest
from commands import rorg
from robots import RealRobot

from rorg.cli.progress import waiting

REST = 10
"""Seconds until the next try: enough for a command to see all services wait, on a busy machine too."""


def all_rest(view) -> bool:
    """Whether all services wait for their next try, and none is near it."""
    left = [re.search(r"again in (\d+) s$", w["reason"]) for w in view["plan"]["waitings"]]
    return len(left) == len(BAD) and all(found and int(found[1]) >= REST for found in left)


BAD = {f"s{i:02}": {"always_on": True, "command": ["/no/such/program"]} for i in range(12)}


@pytest.mark.slow
def test_commands_that_wait_tell_it_once(tmp_path):
    """The process engine refuses every service for one reason."""
    robot = RealRobot(tmp_path, "process", None, with_server=True)
    try:
        robot.declare(BAD)
        robot.wait(lambda: all_rest(robot.client().status()), 120)
        view = robot.client().status()
        lines = waiting(view, sorted(BAD), 1.0)
        assert lines[0] == "0 of 12 ready, 1 s"
        assert len([line for line in lines if "/no/such/program" in line]) == 1, lines
        assert "12 services (s00, s01, s02 and 9 more): " in lines[1]
        state = ("--state-dir", str(robot.state.path))
        done = rorg("wait", *BAD, "--timeout", "1s", *state, code=4)
        assert done.stderr.count("/no/such/program") == 1
        assert re.search(r"\d+ services \(s\d\d, s", done.stderr)
        done = rorg("apply", str(robot.tree), "--yes", "--wait", "--timeout", "5s", *state, code=4)
        lines = [line for line in robot.log() if ": failed: " in line or " is stalled: " in line]
        full = [line for line in lines if "/no/such/program" in line]
        first = full[0].split()[2]
        assert all(line.startswith((f"> start {first} ", f"{first} is stalled")) for line in full), full
        assert any(line.endswith(f"failed: same error as {first}") for line in lines), lines
        entries = [e for e in robot.client().events(tail=500) if e["kind"] == "failed"]
        assert all("/no/such/program" in e["message"] for e in entries), "the journal has it in full"
        after_the_plan = done.stderr.partition("carries it out")[2]
        # Those that are just tried again, or once more, say it in other words.
        assert 1 <= after_the_plan.count("/no/such/program") <= 4, done.stderr
    finally:
        robot.close()
