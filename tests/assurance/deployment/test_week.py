"""A week of the tour guide: its plan, a short part of it on Docker, and the page about the whole (docs/evaluation)."""

from __future__ import annotations

from collections import Counter

import pytest
from common import ROOT, no_docker
from deployment import report
from deployment.editions import Edition, Editions
from deployment.figures import UNKNOWN, UPDATES, Figures
from deployment.play import play
from deployment.player import after
from deployment.tour_guide import begin, free_ports, tour_guide
from deployment.week import CONFIGURATION, DAYS, SOFTWARE, Bad, Event, Kind, first, week
from dockerd import Dockerd

from rorg.manifest.load import load_or_raise

GUIDE = tour_guide()
REMEDY = "try `python -m deployment.report`"


@pytest.mark.parametrize("seed", [1, 2, 77])
def test_a_week_follows_from_its_seed(seed):
    events = week(seed, GUIDE)
    assert events == week(seed, GUIDE)
    assert events != week(seed + 1, GUIDE)
    assert [e.at for e in events] == sorted(e.at for e in events)
    kinds = Counter(e.kind for e in events)
    assert (kinds[Kind.SOFTWARE], kinds[Kind.CONFIGURATION]) == (SOFTWARE, CONFIGURATION) == (126, 71)
    assert kinds[Kind.NIGHT] == DAYS == 7
    bad = Counter(e.kind for e in events if e.bad)
    assert (bad[Kind.SOFTWARE], bad[Kind.CONFIGURATION]) == (13, 7)
    assert bad[Kind.REVERT] == kinds[Kind.REVERT] == 20
    assert {e.bad for e in events} == set(Bad)


def test_a_part_of_a_week_ends_with_nothing_broken():
    for seconds in (100.0, 300.0, 1111.0):
        part = first(week(1, GUIDE), seconds)
        kinds = Counter(e.kind for e in (*part, *after(part)))
        assert kinds[Kind.RORG_STARTED] == kinds[Kind.RORG_KILLED]
        assert kinds[Kind.ENGINE_BACK] == kinds[Kind.ENGINE_CUT] + kinds[Kind.ENGINE_SILENT]
        assert kinds[Kind.REVERT] == sum(bool(e.bad) for e in part if e.kind in UPDATES)


def test_the_tree_declares_the_robot_of_the_manifests(tmp_path):
    begin(GUIDE, tmp_path, free_ports(GUIDE.services))
    catalog, robot = load_or_raise(tmp_path), load_or_raise(ROOT / "manifests")
    assert {n: {*s.needs} for n, s in catalog.services.items()} == {n: {*s.needs} for n, s in robot.services.items()}
    assert {n: s.idle for n, s in catalog.services.items()} == {n: s.idle for n, s in robot.services.items()}


def test_which_editions_are_right():
    editions = Editions(("arm", "map"))

    def push(event: Event, number: int, answers: dict[str, str]) -> None:
        reverts = event.kind is Kind.REVERT
        edition = editions.reverted(event) if reverts else editions.updated(event, number)
        editions.pushed(event.service, edition, answers)

    push(Event(0, Kind.SOFTWARE, "arm"), 1, {})
    assert editions.right["arm"] == {"1 0"}
    bad = Event(1, Kind.CONFIGURATION, "arm", Bad.INVALID)
    push(bad, 2, {"arm": "1 0"})
    push(Event(2, Kind.SOFTWARE, "map"), 1, {})
    assert editions.right == {"arm": {"1 0"}, "map": {"0 0"}}, "the tree is refused as a whole"
    push(Event(3, Kind.REVERT, "arm", Bad.INVALID), 0, {})
    assert editions.right == {"arm": {"1 0"}, "map": {"1 0"}}
    push(Event(4, Kind.SOFTWARE, "map", Bad.EXITS), 2, {"map": "0 0"})
    assert editions.right["map"] == {"1 0", "0 0"}, "it may never have run in its last good edition"
    assert editions.head["map"] == Edition(2, 0, Bad.EXITS)


def recorded(**more: list) -> Figures:
    told = {"asked": [[0, "start", ["roscore", "behavioral"]]], "samples": [[100, 0, 0, 0, 0, 0, 0]], "journal": []}
    told |= {"events": [], "runs": [], "nights": [], "wrong": [], "answers": []}
    return Figures({**told, **more}, GUIDE)


def test_time_without_an_answer_has_a_cause():
    answers = [[1, "roscore", "0 0"], [50, "roscore", ""], [53, "roscore", "0 0"], [70, "roscore", ""]]
    kill = [50, Kind.KILL, "roscore", Bad.NO, "", ""]
    found = recorded(answers=answers, events=[kill])
    assert [(d.begin, d.end, d.cause) for d in found.downs] == [(50, 53, Kind.KILL), (70, 100, UNKNOWN)]
    counted, up = found.availability()["roscore"]
    assert (counted, up) == (99, 66)


def test_a_restart_without_a_cause_is_needless():
    runs = [[1, "start", "roscore", "a", "x"], [50, "die", "roscore", "a", "x"], [51, "start", "roscore", "a", "x"]]
    kill = [49.9, Kind.KILL, "roscore", Bad.NO, "", ""]
    assert [s.at for s in report.needless(recorded(runs=runs))] == [51]
    assert not report.needless(recorded(runs=runs, events=[kill]))
    changed = [*runs[:2], [51, "start", "roscore", "b", "y"]]
    assert not report.needless(recorded(runs=changed))
    not_asked = [[0, "start", ["roscore"]], [48, "night", []], [50.5, "start", ["roscore"]]]
    assert not report.needless(recorded(runs=runs, asked=not_asked))


def test_a_bad_update_and_what_became_of_it():
    update = [10, Kind.SOFTWARE, "roscore", Bad.EXITS, "", ""]
    revert = [40, Kind.REVERT, "roscore", Bad.EXITS, "", ""]
    journal = [[20, "update-failed", "roscore", "ended"], [90, "update-failed", "roscore", "late"]]
    answers = [[1, "roscore", "0 0"], [15, "roscore", ""], [21, "roscore", "0 0"]]
    found = recorded(events=[update, revert], journal=journal, answers=answers)
    assert [(f.outcome, f.down) for f in found.fates()] == [("taken back", 6)]
    assert found.unjust() == []
    assert len(recorded(journal=journal).unjust()) == 2


def test_the_page_shows_the_record():
    found, overview = report.read(), report.OVERVIEW.read_text()
    assert report.page(found) == report.PAGE.read_text(), REMEDY
    assert report.overview(overview, found) == overview, REMEDY
    assert "A week of the tour guide" in report.FIGURES.with_suffix(".svg").read_text()


def test_the_record_is_that_of_a_whole_week():
    played = Counter(event.kind for event in report.read().events)
    assert (played[Kind.SOFTWARE], played[Kind.CONFIGURATION], played[Kind.NIGHT]) == (SOFTWARE, CONFIGURATION, DAYS)


@pytest.mark.docker
def test_a_part_of_a_week_on_docker(tmp_path_factory):
    if why := Dockerd.missing():
        no_docker(why)
    path = tmp_path_factory.mktemp("record") / "deployment.json"
    play(1, 25.0, tmp_path_factory.mktemp("week"), path)
    found = report.read(path)
    assert not report.wrong(found)
    assert not report.needless(found)
    assert {down.cause for down in found.downs} <= {Kind.KILL, *UPDATES}
    assert [r.state for r in found.requests][:2] == ["start", "start"]
