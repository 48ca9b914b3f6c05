"""The journal: what half-written lines cost, and how soon a follower sees a line."""

from __future__ import annotations

import json
import threading

import pytest
from conftest import wait_for
from robots import RealRobot
from test_cli import shell  # noqa: F401

from rorg.store.journal import Journal

WHOLE = {"at": "2026-01-01T00:00:00Z", "kind": "done", "service": "base"}
TORN = [
    '{"seq": 2, "at": "2026-01-01T00:00:01Z", "service": "base", "mess',
    '{"seq": "two", "at": "now", "message": "no number", "service": "base"}',
    '{"seq": 3, "service": "base"}',
    '{"seq": 3, "at": 7, "message": "no time", "service": "base"}',
    '["base"]',
    "[" * 100_000 + '"base"',
    '\0\0\0"base"\0',
]


def write(path, *torn: str) -> None:
    path.parent.mkdir(exist_ok=True)
    lines = [json.dumps({"seq": 1, "message": "first", **WHOLE}), *torn[:-1]]
    lines += [json.dumps({"seq": 9, "message": "second", **WHOLE}), *torn[-1:]]
    path.write_text("\n".join(lines))


@pytest.mark.parametrize("command", [("describe", "base"), ("events",), ("events", "-o", "json")])
def test_commands_pass_over_lines_that_are_not_whole(shell, command):  # noqa: F811
    shell("apply", str(shell.tree), "--yes")
    write(shell.state / "journal.jsonl", *TORN, TORN[0])
    said = shell(*command).stdout
    assert "first" in said
    assert "second" in said
    assert "no number" not in said
    assert "no time" not in said


def test_numbers_go_on_after_lines_that_are_not_whole(tmp_path):
    path = tmp_path / "journal.jsonl"
    write(path, *TORN, TORN[0])
    again = Journal(path)
    again.append("now", "three", "third")
    assert [(e["seq"], e["message"]) for e in Journal(path).since(0)] == [(1, "first"), (9, "second"), (10, "third")]


def test_a_follower_sees_a_line_that_no_pass_comes_after(tmp_path):
    """A worker, the purger of the ROS graph and others write lines that wake no loop."""
    robot = RealRobot(tmp_path, "process", None, with_server=True)
    seen: list[str] = []
    try:
        robot.declare({"camera": {}})
        robot.settle()
        follower = robot.client()
        threading.Thread(
            target=lambda: [seen.append(e["message"]) for e in follower.events(follow=True)], daemon=True
        ).start()
        wait_for(lambda: robot.loop.recorder.journal._followers)
        passes = robot.loop.passes
        for number in range(50):
            robot.loop.recorder.journal.append("now", "told", f"line {number}")
            wait_for(lambda n=number: f"line {n}" in seen, 10, f"line {number}")
        assert robot.loop.passes - passes < 25, "and it was not by chance"
    finally:
        robot.close()
