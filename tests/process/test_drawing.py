"""The picture of the robot of 41 services: what a person looks for in it, checked on its boxes and curves."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from itertools import combinations
from xml.etree import ElementTree

import commands
import pytest
from common import ROOT
from tools import graphviz

from rorg.plots.drawing import LETTER

NEEDED = ("usb_cam", "microphone", "freight_base")


def picture(*words: str) -> ElementTree.Element:
    graphviz()
    done = commands.rorg("graph", str(ROOT / "manifests"), "-o", "svg", *words)
    assert done.stderr == ""
    return ElementTree.fromstring(done.stdout)


@pytest.fixture(scope="module")
def whole() -> ElementTree.Element:
    return picture()


def boxes(drawn: ElementTree.Element) -> dict[str, tuple[float, float, float, float]]:
    """Name -> left, top, right, bottom."""
    found = {}
    for group in drawn.iterfind("{*}g"):
        left, top, width, height = (float(group.find("{*}rect").get(k)) for k in ("x", "y", "width", "height"))
        found[group.find("{*}text").text] = (left, top, left + width, top + height)
    return found


def points(path: ElementTree.Element) -> list[tuple[float, float]]:
    numbers = [float(n) for n in re.findall(r"-?[\d.]+", path.get("d"))]
    return list(zip(numbers[::2], numbers[1::2], strict=True))


@pytest.mark.slow
def test_nothing_is_outside_and_nothing_overlaps(whole):
    _, _, width, height = map(float, whole.get("viewBox").split())
    paths = whole.findall("{*}path")
    assert len(paths) > 30
    for path in paths:
        assert all(0 <= x <= width and 0 <= y <= height for x, y in points(path)), path.get("d")
    placed = boxes(whole)
    for name, (left, top, right, bottom) in placed.items():
        assert 0 <= left < right <= width, name
        assert 0 <= top < bottom <= height, name
        assert LETTER * len(name) <= right - left, f"{name} fits into its box"
    for (one, a), (two, b) in combinations(placed.items(), 2):
        assert a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1], f"{one} and {two} are apart"
    for text in whole.iterfind("{*}text"):
        assert float(text.get("x")) + LETTER * len(text.text) <= width, text.text


def test_arrows_lead_from_who_needs_to_what_is_needed(whole):
    placed = boxes(whole)

    def at(point: tuple[float, float]) -> set[str]:
        x, y = point
        return {
            n
            for n, (left, top, right, bottom) in placed.items()
            if left - 2 <= x <= right + 2 and top - 2 <= y <= bottom + 2
        }

    ends = set()
    for path in whole.findall("{*}path"):
        assert path.get("marker-end"), "it has a head"
        begin, *_, end = points(path)
        ends |= {(a, b) for a in at(begin) for b in at(end)}
    assert {("openface_client", "usb_cam"), ("snowboy", "microphone"), ("teleop", "freight_base")} <= ends
    assert ("navigation", "roscore") not in ends, "it follows from what navigation needs"


def test_a_legend_says_what_shapes_and_arrows_mean(whole):
    texts = [t.text for t in whole.iterfind("{*}text")]
    assert texts == ["always on", "needs; needs that follow from others are left out", "requests"]


@pytest.mark.slow
def test_what_everything_needs_can_be_left_out():
    drawn = picture("--hide", "roscore")
    assert "roscore" not in boxes(drawn)
    assert boxes(drawn).keys() >= set(NEEDED)
    assert [t.text for t in drawn.iterfind("{*}text")][-1] == "without roscore"
    said = commands.rorg("graph", str(ROOT / "manifests"), "--hide", "roscoer", code=2).stderr
    assert said == "rorg: cannot find the service 'roscoer': no such service; try 'roscore'\n"


BROKEN = {
    "an import": 'raise ImportError("libgobject-2.0.so.0: cannot open shared object file")',
    "a layout": "class AGraph:\n    def __init__(self, **_): pass\n"
    "    def add_node(self, *_, **__): pass\n    add_edge = add_node\n"
    '    def layout(self, prog): raise ValueError("no such plugin\\nlibgvplugin_dot_layout.so.6")',
}


@pytest.mark.slow
@pytest.mark.parametrize("what", BROKEN)
def test_a_graphviz_that_does_not_work_is_one_line_with_a_remedy(tmp_path, what):
    """On a bare Debian the libraries that pygraphviz loads are missing."""
    (tmp_path / "pygraphviz.py").write_text(BROKEN[what])
    done = subprocess.run(
        [sys.executable, "-m", "rorg", "graph", ROOT / "manifests", "-o", "svg"],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 2, done.stderr
    assert re.fullmatch(
        r"rorg: cannot draw a picture: pygraphviz does not work here: (libgobject-2.0.so.0|no such plugin)[^\n]*; "
        r"try `apt install graphviz`, which brings the libraries that it needs, or -o mermaid\n",
        done.stderr,
    ), done.stderr


@pytest.mark.slow
@pytest.mark.parametrize(("ci", "outcome"), [("", "3 skipped"), ("true", "3 errors")])
def test_without_graphviz_these_tests_are_skipped_except_in_ci(tmp_path, ci, outcome):
    (tmp_path / "pygraphviz.py").write_text(BROKEN["an import"])
    search = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    needed = {name: value for name, value in os.environ.items() if name != "RORG_TEST_REQUIRE_DOCKER"}
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-rsE", "-k", "whole or nothing or arrows or legend", __file__],
        cwd=ROOT,
        env={**needed, "PYTHONPATH": search, "CI": ci},
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert outcome in done.stdout
    assert "libgobject-2.0.so.0" in done.stdout
    assert "try `apt install graphviz`" in done.stdout
