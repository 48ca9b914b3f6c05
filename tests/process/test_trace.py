"""Traces that are recorded: what a real robot was asked for, by people and by services, is told as it was."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import UTC, datetime, timedelta

import commands
import pytest
from robots import RealRobot

from rorg.errors import Missing
from rorg.history.database import Database
from rorg.history.journal import Journal
from rorg.history.meta_requests import Asked
from rorg.history.request_log import RequestLog
from rorg.manifest.load import load_or_raise
from rorg.manifest.traces import read_trace
from rorg.model.catalog import Request
from rorg.model.trace import TraceEvent
from rorg.model.workload import Workload
from rorg.tools.sim.simulate import simulate

BEGIN = datetime(2026, 1, 31, 10, tzinfo=UTC)


def at(seconds: float) -> str:
    return (BEGIN + timedelta(seconds=seconds)).isoformat(timespec="microseconds").replace("+00:00", "Z")


@pytest.fixture
def records(tmp_path):
    """(journal, what meta-services ask for) of a new database."""
    database = Database(tmp_path / "history.db", lambda: at(0))
    yield Journal(database), Asked(database)
    database.close()


def told(journal: Journal, begin: float, end: float) -> list[tuple[float, str, str, list[str]]]:
    found = RequestLog(journal).between(at(begin), at(end))
    seconds = [(datetime.fromisoformat(r["at"]) - BEGIN).total_seconds() for r in found["requests"]]
    return [(s, r["requester"], r["id"], r["services"]) for s, r in zip(seconds, found["requests"], strict=True)]


def ask(journal: Journal, seconds: float, who: str, id: str, *services: str) -> None:
    kind, more = ("request", {"requested": list(services)}) if services else ("release", {})
    journal.append(at(seconds), kind, "as it says", service=who, request=id, **more)


def test_what_people_ask_for_is_known_from_what_was_in_force(records):
    journal, asked = records
    journal.append(at(0), "started", "rorg begins")
    asked.note(at(1), [Request("tour", "developer", ("navigation",))])
    asked.note(at(5), [Request("tour", "developer", ("navigation", "arm")), Request("look", "operator", ("camera",))])
    asked.note(at(9), [Request("look", "operator", ("camera",))])
    ask(journal, 5, "developer", "tour", "this is on record already")
    assert told(journal, 0, 10) == [
        (1, "developer", "tour", ["navigation"]),
        (5, "developer", "tour", ["navigation", "arm"]),
        (5, "operator", "look", ["camera"]),
        (9, "developer", "tour", []),
    ]
    assert told(journal, 6, 8) == [
        (6, "developer", "tour", ["navigation", "arm"]),
        (6, "operator", "look", ["camera"]),
    ], "what is in force stands at the beginning"


def test_what_services_ask_for_is_known_from_the_journal(records):
    journal, _ = records
    ask(journal, 1, "guide", "go", "navigation")
    ask(journal, 2, "guide", "go", "navigation")
    ask(journal, 3, "guide", "see", "camera")
    ask(journal, 4, "guide", "go")
    journal.append(at(6), "request-dropped", "it is over", service="guide", services=["camera"], request="see")
    ask(journal, 7, "guide", "see")
    ask(journal, 8, "guide", "see", "camera")
    journal.append(at(9), "down", "the robot is taken down")
    assert told(journal, 0, 10) == [
        (1, "guide", "go", ["navigation"]),
        (3, "guide", "see", ["camera"]),
        (4, "guide", "go", []),
        (6, "guide", "see", []),
        (8, "guide", "see", ["camera"]),
        (9, "guide", "see", []),
    ]
    assert told(journal, 3.5, 5) == [(3.5, "guide", "go", ["navigation"]), (3.5, "guide", "see", ["camera"]),
                                     (4, "guide", "go", [])]  # fmt: skip


def test_who_asks_again_and_again_learns_the_same(records):
    journal, _ = records
    log = RequestLog(journal)
    for second in range(40):
        ask(journal, second, "guide", f"go{second % 7}", *(["navigation"] if second % 3 else []))
        anew = RequestLog(journal)
        for begin in (second / 2, second - 1.5, second - 0.5):
            if begin > 0:
                end = at(second + 0.5)
                assert (
                    log.between(at(begin), end)
                    == anew.between(at(begin), end)
                    == RequestLog(journal).between(at(begin), end)
                )


def test_the_reason_of_a_request_is_known(records):
    journal, asked = records
    journal.append(at(0), "started", "rorg begins")
    asked.note(at(1), [Request("tour", "developer", ("navigation",), reason="a visitor")])
    journal.append(at(2), "request", "x", service="guide", request="go", requested=["camera"], reason="it is dark")
    found = RequestLog(journal).between(at(0), at(5))["requests"]
    assert [request["reason"] for request in found] == ["a visitor", "it is dark"]


def test_requests_of_an_earlier_rorg_are_counted_and_left_out(records):
    journal, _ = records
    journal.append(at(1), "request", "request 'go' of guide: navigation", service="guide", request="go")
    found = RequestLog(journal).between(at(0), at(5))
    assert (found["unknown"], found["requests"], found["begin"]) == (1, [], at(1))


@pytest.mark.parametrize(("begin", "end"), [(20, 30), (2, 1), (-9, -5)])
def test_a_time_without_a_record_is_no_trace(records, begin, end):
    journal, _ = records
    if begin < 20:
        journal.append(at(1), "started", "rorg begins")
    with pytest.raises(Missing, match="nothing of that time"):
        RequestLog(journal).between(at(begin), at(end))


# -- a real robot ----------------------------------------------------------------------------------------------

SERVICES = {
    "guide": {"may_request": ["navigation", "camera"]},
    "navigation": {"needs": ["laser"]},
    "laser": {},
    "camera": {},
    "base": {"always_on": True},
}


@pytest.fixture
def robot(tmp_path):
    found = RealRobot(tmp_path, "process", None, with_server=True)
    found.declare(SERVICES)
    found.wait(lambda: "base" in found.active())
    yield found
    found.close()


def rorg(robot: RealRobot, *words: str, code: int = 0) -> str:
    return commands.rorg(*words, code=code, RORG_STATE_DIR=str(robot.state.path), RORG_ENGINE="process").stdout


def play(robot: RealRobot) -> list[set[str]]:
    """What is active after each change."""
    found = []

    def shows(*active: str) -> None:
        robot.wait(lambda: robot.active() == {"base", *active})
        found.append(robot.active())

    developer = robot.client()
    developer.call("PUT", "/v1/requests/work", {"services": ["guide"]})
    shows("guide")
    guide = robot.client("guide")
    guide.call("PUT", "/v1/requests/go", {"services": ["navigation"]})
    shows("guide", "navigation", "laser")
    guide.call("PUT", "/v1/requests/go", {"services": ["camera"]})
    shows("guide", "camera")
    guide.call("DELETE", "/v1/requests/go")
    shows("guide")
    guide.call("PUT", "/v1/requests/go", {"services": ["camera"]})
    shows("guide", "camera")
    developer.call("DELETE", "/v1/requests/work")
    shows()
    robot.wait(lambda: any("dropped" in line for line in robot.log()))
    return found


@pytest.mark.slow
def test_what_a_robot_was_asked_for_is_recorded_with_a_running_rorg_and_without(robot, tmp_path):
    play(robot)
    until = robot.loop.recorder.journal.after(0, 10_000)[-1]["at"]
    paths = [tmp_path / folder / "today.yaml" for folder in ("running", "alone")]
    for path in paths:
        path.parent.mkdir()
        rorg(robot, "trace", "record", "--since", "1h", "--until", until, "--file", str(path))
        if robot.loop:
            robot.stop()
    assert paths[0].read_text() == paths[1].read_text()
    trace = read_trace(paths[0], SERVICES)
    assert trace.name == "today"
    assert [(e.requester, e.id, e.services) for e in trace.events] == [
        ("developer", "work", ("guide",)),
        ("guide", "go", ("navigation",)),
        ("guide", "go", ("camera",)),
        ("guide", "go", ()),
        ("guide", "go", ("camera",)),
        ("developer", "work", ()),
        ("guide", "go", ()),
    ]
    assert all(isinstance(e, TraceEvent) and 0 <= e.at <= trace.duration for e in trace.events)
    shown = json.loads(rorg(robot, "trace", "show", str(paths[0]), "-o", "json"))
    assert [(a["by"], a["name"], a["times"]) for a in shown["activities"]] == [
        ("developer", "work", 1),
        ("guide", "go", 3),
    ]


def test_yesterday_is_simulated_as_it_was(robot, tmp_path):
    """Its events are ten seconds apart, since programs of the simulation take longer to come up than these."""
    active = play(robot)
    rorg(robot, "trace", "record", "--since", "1h", "--file", str(tmp_path / "today.yaml"))
    trace = read_trace(tmp_path / "today.yaml", SERVICES)
    events = tuple(replace(event, at=10.0 * n) for n, event in enumerate(trace.events))
    slower = replace(trace, duration=10.0 * len(events), events=events)
    result = simulate(load_or_raise(robot.tree), slower, Workload(), 1)
    changes = [event.at for event in events[1:6]]
    found = [max((s for s in result.samples if s.at < at), key=lambda s: s.at).active for at in changes]
    assert [*found, result.samples[-1].active] == active
    assert not result.violations
