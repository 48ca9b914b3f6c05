"""What a long journal costs: those who ask it, and the loop that writes it: `make bench`."""

from __future__ import annotations

import shutil
import statistics
import time

import pytest
from command_times import ENVIRONMENT, RORG, measure
from histories import owned, wall
from rorg_process import RorgProcess

from rorg.history.database import Database
from rorg.history.journal import ABOUT, ENTRY, Filter, Journal, checksum
from rorg.history.maintenance import Maintenance
from rorg.history.retention import Retention
from rorg.history.revisions import Made, Revision, Revisions
from rorg.model.units import stamp

ENTRIES, REVISIONS = 100_000, 1000
BEGIN = time.time() - 200_000
KINDS = ("done", "request", "release", "crashed", "lost", "holds", "pressure", "tree-accepted")
FILTERS = {
    "all": Filter(),
    "kind": Filter(kinds=frozenset({"crashed"})),
    "service": Filter(services=frozenset({"s07"})),
    "kind and service": Filter(kinds=frozenset({"crashed"}), services=frozenset({"s07"})),
    "an hour": Filter(since=stamp(BEGIN + 50_000), until=stamp(BEGIN + 53_600)),
    "text": Filter(text="number 4711 "),
    "nothing": Filter(text="nothing like this"),
}


@pytest.fixture(scope="module")
def long(tmp_path_factory):
    """A state directory with a long journal."""
    state = tmp_path_factory.mktemp("long")
    database = Database(state / "journal.db", wall)
    written = [
        (
            *(n, stamp(BEGIN + n), KINDS[n % 8], f"entry number {n} of s{n % 40:02}: done in 12 ms", int(n % 8 == 1)),
            f'{{"service": "s{n % 40:02}", "verb": "start", "seconds": 0.012}}',
        )
        for n in range(1, ENTRIES + 1)
    ]
    rows = [(*values, checksum(*values)) for values in written]
    about = [(f"s{n % 40:02}", n) for n in range(1, ENTRIES + 1)]
    assert database.write([(ENTRY, rows), (ABOUT, about)])
    revisions = Revisions(database)
    for number in range(REVISIONS):
        made = {f"s{n:02}": Made(f"v1:{n}-{number // 40 if n else number}", "{}", "ros:noetic") for n in range(40)}
        revisions.begin(Revision(0, stamp(BEGIN + 100 * number), f"f{number}", "a" * 40, services=made))
    database.checkpoint()
    database.close()
    return state


@pytest.mark.parametrize("name", FILTERS)
def test_a_long_journal_is_asked(long, name):
    """By a process that has not asked it before: what a command adds to its own start."""
    found = []
    for _ in range(15):
        began = time.perf_counter()
        database = Database(long / "journal.db")
        Journal(database).select(FILTERS[name], 50, newest=True)
        found.append((time.perf_counter() - began) * 1000)
        database.close()
    print(f"\n{name}: {statistics.median(found):.1f} ms", end="")
    assert statistics.median(found) < 100


def test_revisions_are_listed(long):
    began = time.perf_counter()
    revisions = Revisions(Database(long / "journal.db"))
    listed = revisions.list(20)
    listing = time.perf_counter() - began
    assert len(revisions.get(listed[0].number).services) == 40
    print(
        f"\n20 revisions: {listing * 1000:.1f} ms, one whole: {(time.perf_counter() - began - listing) * 1000:.1f} ms"
    )
    assert time.perf_counter() - began < 0.1


LINES = {
    "events": ["events", "--tail", "50"],
    "events of a kind": ["events", "--kind", "crashed", "--tail", "50"],
    "events of a service": ["events", "--service", "s07", "--tail", "50"],
    "events by text": ["events", "--grep", "number 4711 ", "--tail", "50"],
    "history": ["history"],
}
"""Whole commands: each must answer within 300 ms."""


@pytest.mark.parametrize("name", LINES)
def test_a_command_without_a_loop(long, name):
    env = {**ENVIRONMENT, "RORG_STATE_DIR": str(long)}
    assert measure(f"rorg {name}", [*RORG, *LINES[name]], env) < 300


@pytest.fixture(scope="module")
def served(long, tmp_path_factory):
    """The environment of a command that finds a running rorg with that journal."""
    folder = tmp_path_factory.mktemp("served")
    shutil.copytree(long, folder / "state")
    robot = RorgProcess(folder, {"camera": {}}).start()
    robot.client(patience=60).status()
    yield {**ENVIRONMENT, "RORG_STATE_DIR": str(robot.state)}
    robot.close()


@pytest.mark.parametrize("name", LINES)
def test_a_command_with_a_loop(served, name):
    assert measure(f"rorg {name}, with a loop", [*RORG, *LINES[name]], served) < 300


def test_an_entry_is_written(long):
    journal = owned(long / "journal.db")
    beside = Maintenance(journal.database, lambda kind, text: None, Retention, time.time)
    beside.start()
    found = []
    for number in range(3000):
        began = time.perf_counter()
        journal.append(
            wall(), "done", f"start camera: done in {number} ms", service="camera", verb="start", seconds=0.1
        )
        found.append((time.perf_counter() - began) * 1000)
        time.sleep(0.001)
    beside.stop()
    journal.database.close()
    mean, p99 = statistics.mean(found), statistics.quantiles(found, n=100)[98]
    print(f"\nan entry: mean {mean:.3f} ms, p99 {p99:.3f} ms, worst {max(found):.3f} ms", end="")
    assert mean < 1
    assert p99 < 1
