"""One root cause of many services is told once, with their names."""

from __future__ import annotations

import re

from commands import rorg
from robots import RealRobot

from rorg.cli.progress import waiting
from rorg.model.causes import causes

PARAGRAPH = "Error response: failed to create task: exec apparmor_parser: executable file not found in $PATH"


def refused(name: str, number: int) -> str:
    return f"start failed: cannot start {number:012x}: {PARAGRAPH}; try `journalctl -u docker`; again in {number} s"


def test_an_equal_cause_is_told_once_with_the_names():
    names = [f"s{i:02}" for i in range(20)]
    told = causes([*((n, refused(n, i)) for i, n in enumerate(names)), ("a", "waits for s00"), ("b", "waits for s00")])
    assert [str(cause) for cause in told] == [
        f"20 services (s00, s01, s02 and 17 more): start failed: cannot start them: {PARAGRAPH}; "
        "try `journalctl -u docker`",
        "2 services (a, b): waits for s00",
    ]


def test_failed_once_or_often_is_one_cause():
    told = causes(
        [("a", "start failed: no program x; again in 1 s"), ("b", "start stalled: no program x; again in 4 s")]
        + [("c", "start stalled: no program x; trying again now")]
    )
    assert [str(cause) for cause in told] == ["3 services (a, b, c): start failed: no program x"]


def test_a_cause_of_one_service_stays_as_it_is_and_others_stay_apart():
    assert [str(c) for c in causes([("a", refused("a", 7))])] == [f"a: {refused('a', 7)}"]
    told = causes([("a", "image a:latest not found"), ("b", "image b:latest not found")])
    assert [c.who for c in told] == ["a", "b"], "two images are two causes"
    assert (
        causes([("a", "start failed: cannot start x: no"), ("b", "create failed: cannot create y: no")])[1].who == "b"
    )


REST = 10
"""Seconds until the next try: enough for a command to see all services wait, on a busy machine too."""


def all_rest(view) -> bool:
    """Whether all services wait for their next try, and none is near it."""
    left = [re.search(r"again in (\d+) s$", w["reason"]) for w in view["plan"]["waitings"]]
    return len(left) == len(BAD) and all(found and int(found[1]) >= REST for found in left)


BAD = {f"s{i:02}": {"always_on": True, "command": ["/no/such/program"]} for i in range(12)}


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
