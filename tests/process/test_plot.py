"""`rorg plot`: the pictures of a robot that ran, by the states that the page shows too."""

from __future__ import annotations

import re
import time
from pathlib import Path
from xml.etree import ElementTree

import pytest
from commands import rorg
from common import ROOT, wait_for
from rorg_client import Client
from rorg_process import RorgProcess
from tools import graphviz

from rorg.history.database import Database
from rorg.history.usage import MACHINE, Measured, UsageTable
from rorg.model.units import parse_time, stamp
from rorg.plots.figure import install
from rorg.plots.states import LOOKS, OF_STATE, REQUEST
from rorg.plots.timeline import bars_of_requests
from rorg.plots.times import Use, uses
from rorg.plots.usage import MOST, stacked

PAGE = ROOT / "rorg/web/page"
TOUR = {
    "tour": {"needs": ["navigation"]},
    "navigation": {"idle": {"linger": "0s", "action": "pause"}},
    "arm": {"always_on": True, "driver": True},
    "broken": {"command": ["false"]},
    "unused": {},
}


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    made = RorgProcess(tmp_path_factory.mktemp("plot"), TOUR)
    made.start()
    wait_for(lambda: Path(made.socket()).exists(), 30, "rorg to answer")
    client = made.client()
    client.call("PUT", "/v1/requests/visitor", {"services": ["tour", "broken"], "reason": "a visitor"})
    wait_for(lambda: client.status()["services"]["broken"]["crashes"] > 0, 30, "a crash")
    wait_for(lambda: client.status()["services"]["tour"]["health"] == "Healthy", 30, "the tour")
    client.release("visitor")
    wait_for(lambda: told_last(client, "tour") == "exited", 30, "the journal to tell that the tour ended")
    wait_for(lambda: told_last(client, "navigation") == "paused", 30, "the journal to tell that navigation rests")
    database = Database(made.state / "journal.db", lambda: "")
    used = [Measured(MACHINE, "", 60.0, 90.0, 2 << 30), Measured("navigation", "r", 30.0, 30.0, 1 << 30)]
    UsageTable(database).note(stamp(time.time() - 600), used)
    database.close()
    yield made
    made.close()


def told_last(client: Client, service: str) -> str:
    """The last state that the journal, which a picture is drawn from, tells of a service."""
    return client.call("GET", f"/v1/timeline/{service}")["spans"][-1]["state"]


def texts(path: Path) -> set[str]:
    """All that a picture says."""
    return {"".join(text.itertext()) for text in ElementTree.parse(path).iter("{http://www.w3.org/2000/svg}text")}


@pytest.mark.slow
def test_the_timeline_has_a_lane_for_all_that_ran_and_a_row_for_each_request(robot, tmp_path):
    rorg("plot", "timeline", "-o", tmp_path / "story.svg", "--state-dir", robot.state)
    told = texts(tmp_path / "story.svg")
    assert {"tour", "navigation", "arm", "broken", "tour, broken (developer)", "CPU (cores)", "memory (GiB)"} <= told
    assert {"ready", "idle", "stopped", "failing"} <= told, "the legend"
    assert "unused" not in told, "it never ran"
    rorg("plot", "timeline", "unused", "-o", tmp_path / "none.svg", "--state-dir", robot.state)
    assert "unused" in texts(tmp_path / "none.svg"), "it was named"


@pytest.mark.slow
def test_the_same_record_gives_the_same_picture_and_needs_no_rorg(robot, tmp_path):
    times = ["--since", stamp(time.time() - 900), "--until", stamp(time.time())]
    for name in ("one", "two"):
        rorg("plot", "usage", *times, "-o", tmp_path / f"{name}.svg", "--state-dir", robot.state)
    robot.stop()
    try:
        rorg("plot", "usage", *times, "-o", tmp_path / "three.svg", "--state-dir", robot.state)
        rorg("plot", "timeline", "-o", tmp_path / "story.svg", "--state-dir", robot.state)
        assert "tour, broken (developer)" in texts(tmp_path / "story.svg")
        assert "`rorg run`" in rorg("plot", "graph", "--state-dir", robot.state, cwd=tmp_path, code=3).stderr
    finally:
        robot.start()
        wait_for(lambda: Path(robot.socket()).exists(), 30, "rorg to answer again")
        robot.client(patience=30.0).services()
    assert len({(tmp_path / f"{name}.svg").read_bytes() for name in ("one", "two", "three")}) == 1
    assert {"navigation", "the machine"} <= texts(tmp_path / "one.svg")


def test_the_graph_shows_states_by_sign_and_colour(robot, tmp_path):
    graphviz()
    rorg("plot", "graph", "-o", tmp_path / "graph.svg", "--state-dir", robot.state)
    told = texts(tmp_path / "graph.svg")
    assert {"● arm", "◫ navigation", "○ tour", "○ unused", "needs"} <= told
    rorg("plot", "graph", "navigation", "-o", tmp_path / "part.svg", "--state-dir", robot.state)
    assert {name for name in texts(tmp_path / "part.svg") if name[1:2] == " "} == {"◫ navigation", "○ tour"}


@pytest.mark.parametrize("what", ["usage", pytest.param("timeline", marks=pytest.mark.slow), "graph"])
def test_every_picture_comes_in_every_form(robot, tmp_path, what):
    if what == "graph":
        graphviz()
    for form in ("svg", "png", "html"):
        rorg("plot", what, "-o", tmp_path / f"x.{form}", "--state-dir", robot.state)
    assert (tmp_path / "x.png").read_bytes().startswith(b"\x89PNG")
    page = (tmp_path / "x.html").read_text()
    assert page.startswith("<!doctype html>")
    assert page.count("<svg") == 1
    assert "<script" not in page
    assert "<?xml" not in page


def test_what_matplotlib_says_of_its_own_cache_is_not_shown(robot, tmp_path):
    """On its first run it warns that it builds a cache of fonts. That it has no place for it shows sooner."""
    (tmp_path / "file").touch()
    words = ["plot", "usage", "-o", tmp_path / "usage.svg", "--state-dir", robot.state]
    done = rorg(*words, MPLCONFIGDIR=str(tmp_path / "file/matplotlib"))
    assert done.stderr == f"wrote {tmp_path / 'usage.svg'}\n"


def test_what_plots_need_is_installed_as_rorg_was(monkeypatch, tmp_path):
    assert install() == "`pip install 'rorg[plots]'`"
    (tmp_path / "pipx_metadata.json").touch()
    monkeypatch.setattr("sys.prefix", str(tmp_path))
    assert install() == "`pipx inject rorg matplotlib pygraphviz`"


def test_what_cannot_be_drawn_says_why(robot, tmp_path):
    where = {"cwd": tmp_path, "code": 2}
    assert "'.gif' is not a supported format" in rorg("plot", "usage", "-o", "x.gif", **where).stderr
    assert "usage" in rorg("plot", "usgae", "--state-dir", robot.state, **where).stderr
    assert "nosuch" in rorg("plot", "graph", "nosuch", "--state-dir", robot.state, **where).stderr
    long_ago = ["--since", "2020-01-01T00:00:00Z", "--until", "2020-01-02T00:00:00Z", "--state-dir", robot.state]
    assert "nothing ran in that time" in rorg("plot", "timeline", *long_ago, **where).stderr
    assert "nothing of that time is on record" in rorg("plot", "usage", *long_ago, **where).stderr
    assert list(tmp_path.iterdir()) == []


def test_a_state_looks_the_same_here_and_on_the_page():
    style, lanes = (PAGE / "style.css").read_text(), (PAGE / "lanes.js").read_text()
    light = dict(re.findall(r"--([\w-]+): (#\w+)", style.partition("@media")[0]))
    for name, look in LOOKS.items():
        assert (look.edge, look.box) == (light[name], light[f"{name}-fill"]), name
        assert look.bar in (look.edge, look.box)
    assert light["request"] == REQUEST
    states = dict(re.findall(r"(\w+): \"(\w+)\"", lanes.partition("const STATES = {")[2].partition("}")[0]))
    assert states == {**OF_STATE, "none": "none"}
    signs = dict(re.findall(r"(\w+): \{ shape: \"(.)\"", (PAGE / "store.js").read_text()))
    assert {name: look.sign for name, look in LOOKS.items()}.items() <= signs.items()


def test_requests_follow_each_other_in_the_row_of_what_they_want():
    at = "2026-01-01T00:00:0{}Z".format
    key = {"requester": "guide", "id": "go"}
    records = [
        {"at": at(1), **key, "services": ["navigation"]},
        {"at": at(3), **key, "services": ["arm"]},
        {"at": at(5), **key, "services": []},
        {"at": at(7), **key, "services": ["navigation"]},
    ]
    begin = parse_time(at(0))
    rows = bars_of_requests(records, begin + 9)
    found = {row: [(bar.begin - begin, bar.end - begin) for bar in bars] for row, bars in rows.items()}
    assert found == {"navigation (guide)": [(1, 3), (7, 9)], "arm (guide)": [(3, 5)]}


def test_the_smallest_users_share_an_area():
    slots = [(0.0, 60.0), (60.0, 120.0)]
    used = {f"s{n}": Use(slots[n % 2 :], [float(n)] * (2 - n % 2), [1.0] * (2 - n % 2)) for n in range(MOST + 3)}
    areas = stacked(used)
    assert f"s{MOST + 2}" in list(areas)[:2], "those that used most come first"
    assert len(areas) == MOST + 1
    assert sum(sum(use.cores) for use in areas.values()) == sum(sum(use.cores) for use in used.values())
    assert all(list(use.slots) == slots for use in areas.values())


def test_slots_of_every_length_are_read():
    slots = [
        {"at": "2026-01-01T14", "seconds": 3600, "service": "", "cores": 1.0, "memory": 1.0},
        {"at": "2026-01-01T15:3", "seconds": 600, "service": "", "cores": 2.0, "memory": 2.0},
        {"at": "2026-01-01T16:07", "seconds": 60, "service": "", "cores": 3.0, "memory": 3.0},
    ]
    begin = parse_time("2026-01-01T14:00:00Z")
    assert [(a - begin, b - begin) for a, b in uses(slots)[""].slots] == [(0, 3600), (5400, 6000), (7620, 7680)]
    times, values = uses(slots)[""].line("cores")
    assert values == [1.0, 1.0, 2.0, 2.0, 3.0, 3.0]
    assert times == sorted(times)
