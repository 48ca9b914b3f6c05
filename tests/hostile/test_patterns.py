"""Patterns that take for ever in an engine that tries again and again (a service's output is anybody's)."""

from __future__ import annotations

import time

import pytest
from robots import RealRobot

from rorg.images.ignore import Ignore
from rorg.manifest.patterns import compiled

SLOW = {r"^(\w+\s?)+ready$": "a" * 35 + "!", r"(a*)*b": "a" * 5000, r"(x+x+)+y": "x" * 5000, r"(.*,){20}P": ",a" * 5000}


@pytest.mark.parametrize(("pattern", "text"), SLOW.items(), ids=SLOW)
def test_no_pattern_takes_long(pattern, text):
    began = time.process_time()
    assert not compiled(pattern).search(text * 20)
    assert time.process_time() - began < 2.0


@pytest.mark.parametrize("line", ["*a" * 12, "**/" * 12 + "b", "?*" * 40 + "[b]", "[a-a]*" * 30 + "b"])
def test_no_line_of_an_ignore_file_takes_long(line):
    began = time.process_time()
    Ignore([line, f"!{line}"]).leaves_out(["a" * 200] * 6)
    assert time.process_time() - began < 2.0


def test_an_ignore_file_means_names_of_any_bytes():
    assert Ignore(["a*"]).leaves_out(["a\udcff"])
    assert not Ignore(["b*"]).leaves_out(["a\udcff"])


def test_a_pattern_matches_as_lines_are_read():
    assert compiled("^serving on [0-9]+$").search("starting\nserving on 80\nmore")
    assert not compiled("^serving$").search("not serving")
    assert compiled("größe").search("die größe")


def test_the_loop_goes_on_beside_a_slow_pattern(tmp_path):
    pattern, text = next(iter(SLOW.items()))
    robot = RealRobot(tmp_path, "process", "")
    say = ["sh", "-c", f"echo '{text}'; exec sleep 1000"]
    try:
        slow = {"command": say, "ready": {"log": pattern}}
        robot.declare({"slow": slow, "late": {"always_on": True, "needs": ["slow"]}, "camera": {}})
        robot.wait(lambda: "no line of its output matches" in robot.waits("late"))
        robot.request("camera")
        robot.wait(lambda: "camera" in robot.active())
    finally:
        robot.close()
