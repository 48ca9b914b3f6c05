"""The journal: what a kill, a damaged file or a full disk cost, and how soon a follower sees an entry."""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from pathlib import Path

import pytest
from cli_shell import shell  # noqa: F401
from common import wait_for
from histories import entries, integrity, owned, small_disk, wall
from robots import RealRobot

from rorg.errors import Invalid
from rorg.history import maintenance, retention
from rorg.history.database import Database, reading
from rorg.history.journal import Filter, Journal
from rorg.history.maintenance import Maintenance
from rorg.history.retention import Retention
from rorg.history.revisions import Made, Revision, Revisions
from rorg.host.clock import wall_clock
from rorg.model.units import parse_time, stamp

ROUNDS = 200
NOW = "2026-11-22T12:00:00.000000Z"


@pytest.fixture
def path(tmp_path):
    return tmp_path / "journal.db"


def kept(database: Database, events: int = 1000, now: float | None = None) -> Maintenance:
    """What its thread would do, without the thread."""
    return Maintenance(database, lambda kind, text: None, lambda: Retention(events=events), lambda: now or time.time())


def numbers(found: list[dict]) -> list[int]:
    return [entry["seq"] for entry in found]


# -- kills and damage --------------------------------------------------------------------------------------------


def writing(path, acknowledge: int) -> None:
    """Writes until it is killed, and says after each entry which one is written."""
    database = Database(path, wall)
    journal, revisions = Journal(database), Revisions(database)
    threading.Thread(target=lambda: [database.checkpoint() for _ in iter(int, 1)], daemon=True).start()
    for number in range(10**9):
        journal.append(wall(), "told", f"{number}" * 40, person=number % 3 == 0, service=f"s{number % 5}")
        os.write(acknowledge, journal.last.to_bytes(4, "big"))
        if number % 10 == 9:
            revisions.begin(Revision(0, wall(), f"f{number}", services={"arm": Made(f"v1:{number}", "{}")}))


def killed_while_writing(path, after: int) -> int:
    """The number of the last entry of which it said that it is written."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        with contextlib.suppress(BaseException):
            writing(path, write)
        os._exit(1)
    os.close(write)
    with os.fdopen(read, "rb", 0) as pipe:
        for _ in range(after):
            assert pipe.read(4), "it ended by itself"
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        rest = pipe.read()
    found = entries(path)
    assert numbers(found) == list(range(1, len(found) + 1)), "none is missing, and none is there twice"
    assert len(found) >= after + len(rest) // 4
    return len(found)


@pytest.mark.slow
def test_nothing_that_was_written_is_lost_by_a_kill(path):
    dice, last = random.Random(14), 0
    for number in range(ROUNDS):
        before, after = last, dice.randrange(1, 30)
        last = killed_while_writing(path, after)
        assert last >= before + after
        if number % 20 == 19:
            assert integrity(path) == "ok"
            with reading(path) as database:
                found = Revisions(database).list(5)
                assert [r.number for r in found] == list(range(found[0].number, found[0].number - len(found), -1))


def test_a_log_that_was_cut_anywhere_costs_only_its_end(path, tmp_path):
    """As a loss of power leaves it: what a checkpoint has brought to the disk is there, and a part of what came after
    it; a part that was not written whole counts as nothing."""
    journal, dice = owned(path), random.Random(14)
    for number in range(20):
        journal.append(NOW, "told", f"{number}", service="arm")
    journal.database.checkpoint()
    for number in range(20, 60):
        journal.append(NOW, "told", f"{number}", service="arm")
    copy = tmp_path / "later" / path.name
    copy.parent.mkdir()
    for _ in range(40):
        shutil.copy(path, copy)
        log = bytearray((tmp_path / "journal.db-wal").read_bytes())
        at = dice.randrange(len(log))
        log[at:] = dice.choice([b"", bytes(len(log) - at), dice.randbytes(len(log) - at)])
        copy.with_name("journal.db-wal").write_bytes(log)
        found = numbers(entries(copy))
        assert found == list(range(1, len(found) + 1))
        assert len(found) >= 20
        assert integrity(copy) == "ok"
        again = owned(copy)
        again.append(NOW, "told", "after")
        assert numbers(entries(copy)) == list(range(1, len(found) + 2))
        again.database.close()
        for file in copy.parent.iterdir():
            file.unlink()


@pytest.mark.parametrize("content", [b"no database at all " * 100, b"SQLite format 3\0" + b"\xff" * 4000])
def test_a_damaged_file_is_moved_aside_and_told(path, content):
    path.write_bytes(content)
    journal = owned(path)
    journal.append(NOW, "told", "first")
    assert [e["message"] for e in entries(path)] == ["first"]
    assert [kind for kind, _ in journal.database.take_notes()] == ["journal-damaged"]
    (aside,) = path.parent.glob("journal.damaged-*.db")
    assert aside.read_bytes() == content


def test_a_page_that_is_damaged_is_found_and_what_is_remembered_goes_on(path):
    journal = owned(path)
    for number in range(300):
        journal.append(NOW, "told", f"{number}" * 20, service="arm")
    journal.database.close()
    content = bytearray(path.read_bytes())
    for at in range(4096, len(content), 2048):
        content[at : at + 64] = b"\xff" * 64
    path.write_bytes(content)
    look = kept(journal.database)
    journal.append(NOW, "told", "300")
    look.look()
    journal.append(NOW, "told", "301")
    assert list(path.parent.glob("journal.damaged-*.db"))
    assert integrity(path) == "ok"
    assert numbers(entries(path))[-1] == 302
    assert numbers(journal.since(0)) == list(range(1, 303)), "memory has what the file has not"


def test_a_file_of_a_newer_rorg_is_moved_aside(path):
    journal = owned(path)
    journal.append(NOW, "told", "first")
    journal.database.write([("PRAGMA user_version = 99", [()])])
    journal.database.close()
    again = owned(path)
    again.append(NOW, "told", "first of this one")
    assert [e["message"] for e in entries(path)] == ["first of this one"]
    assert "newer rorg" in again.database.take_notes()[0][1]


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir], ids=["pipe", "directory"])
@pytest.mark.parametrize("end", ["", "-wal"])
def test_what_is_no_file_in_its_place_stops_nobody(path, make, end):
    make(f"{path}{end}")
    journal = owned(path)
    journal.append(NOW, "told", "first")
    assert [e["message"] for e in journal.since(0)] == ["first"]
    if not end:
        with pytest.raises(Invalid):
            entries(path)


def test_a_file_that_is_taken_away_is_begun_anew(path):
    journal = owned(path)
    look = kept(journal.database)
    journal.append(NOW, "told", "first")
    look.look()
    for file in path.parent.iterdir():
        file.unlink()
    journal.append(NOW, "told", "second")
    look.look()
    journal.append(NOW, "told", "third")
    assert [(e["seq"], e["message"]) for e in entries(path)] == [(3, "third")]


# -- disks -------------------------------------------------------------------------------------------------------


def test_a_full_disk_loses_no_entry_that_memory_holds(tmp_path):
    with small_disk(tmp_path / "disk", "256k") as disk:
        journal = owned(disk / "journal.db")
        look = kept(journal.database)
        journal.append(NOW, "told", "first")
        (disk / "other").write_bytes(b"x" * (80 << 10))
        with contextlib.suppress(OSError), (disk / "more").open("wb", 0) as file:
            while file.write(b"x" * 1024):
                pass
        for number in range(200):
            journal.append(NOW, "told", f"{number}" * 100)
        assert journal.database.trouble
        assert numbers(journal.since(0)) == list(range(1, 202)), "what memory has is answered meanwhile"
        look.look()
        assert journal.database.trouble
        (disk / "more").unlink()
        (disk / "other").unlink()
        look.look()
        assert not journal.database.trouble
        assert numbers(entries(disk / "journal.db")) == list(range(1, 202))
        journal.database.close()


def test_a_disk_that_is_read_only_stops_nobody(tmp_path):
    with small_disk(tmp_path / "disk", "1m") as disk:
        journal = owned(disk / "journal.db")
        journal.append(NOW, "told", "first")
        journal.database.close()
        subprocess.run(["mount", "-o", "remount,ro", disk], check=True)
        journal.append(NOW, "told", "second")
        assert [e["message"] for e in journal.since(0)] == ["first", "second"]
        assert [e["message"] for e in entries(disk / "journal.db")] == ["first"]
        assert "journal-not-written" in [kind for kind, _ in journal.database.take_notes()]
        subprocess.run(["mount", "-o", "remount,rw", disk], check=True)
        kept(journal.database).look()
        assert [e["message"] for e in entries(disk / "journal.db")] == ["first", "second"]
        journal.database.close()


@pytest.mark.parametrize("open", [True, False], ids=["while it is written", "afterwards"])
def test_whoever_may_read_it_reads_it(open):
    """A member of the group to whom the files were given, who may write nothing there."""
    with tempfile.TemporaryDirectory(dir="/tmp") as folder, small_disk(Path(folder, "disk"), "1m") as disk:
        Path(folder).chmod(0o755)
        path, group = disk / "journal.db", 4711
        journal = owned(path)
        journal.append(NOW, "told", "first")
        if not open:
            journal.database.close()
        for place in (disk, *disk.iterdir()):
            os.chown(place, 0, group)
        disk.chmod(0o750)
        assert {oct(p.stat().st_mode & 0o777) for p in disk.iterdir()} == {"0o640"}
        there = sorted(disk.iterdir())
        child = os.fork()
        if child == 0:
            os.setgroups([])
            os.setgid(group)
            os.setuid(4711)
            with contextlib.suppress(BaseException):
                os._exit(0 if [e["message"] for e in entries(path)] == ["first"] else 1)
            os._exit(2)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        assert sorted(disk.iterdir()) == there, "reading leaves nothing behind"
        journal.database.close()


# -- what is kept, and what is found ------------------------------------------------------------------------------


def test_people_are_counted_apart(path, monkeypatch):
    monkeypatch.setattr(retention, "BATCH", 10)
    journal = owned(path)
    for number in range(120):
        journal.append(NOW, "told", f"{number}", person=number % 40 == 0, service="arm")
    kept(journal.database, events=50).look()
    found = entries(path)
    assert [e["message"] for e in found if int(e["message"]) % 40 == 0] == ["0", "40", "80"]
    assert len(found) in (52, 53)
    assert numbers(found)[-1] == 120
    with reading(path) as database:
        about = Journal(database).select(Filter(services=frozenset({"arm"})), 1000)
    assert numbers(about) == numbers(found)
    assert journal.database.rows("SELECT count(*) FROM about") == [(len(found),)]


def test_what_is_too_old_goes_but_for_the_last_of_each(path):
    database = Database(path, wall)
    journal, revisions = Journal(database), Revisions(database)
    old = stamp(1_000_000.0)
    for number in range(5):
        journal.append(old, "told", f"{number}")
        revisions.begin(Revision(0, old, f"f{number}", services={"arm": Made(f"v1:{number}", "{}")}))
        revisions.settle(number + 1, "good" if number == 1 else "failed", "", old)
    journal.append(wall(), "told", "now")
    kept(database).look()
    assert numbers(entries(path)) == [6]
    assert [r.number for r in revisions.list(10)] == [5, 2]
    assert revisions.get(2).services["arm"].digest == "v1:1"
    assert owned(path).last == 6


def test_a_clock_that_is_far_ahead_makes_nothing_old(path):
    """It is set 50 years ahead while rorg runs, and the next one sets out from what was written before."""
    journal = owned(path)
    for number in range(5):
        journal.append(NOW, "told", f"{number}")
    look = kept(journal.database, now=parse_time(NOW) + 50 * 365 * 86_400)
    journal.append(stamp(look.wall()), "told", "by the wrong clock")
    look.look()
    assert numbers(entries(path)) == [1, 2, 3, 4, 5, 6]


def test_the_file_is_bounded(path, monkeypatch):
    monkeypatch.setattr(retention, "MOST_BYTES", 400_000)
    monkeypatch.setattr(retention, "LEAST", 20)
    journal = owned(path)
    journal.append(NOW, "told", "by a person", person=True)
    for _ in range(600):
        journal.append(NOW, "told", "x" * 2000)
    kept(journal.database).look()
    pages, free = (journal.database.rows(f"PRAGMA {name}_count")[0][0] for name in ("page", "freelist"))
    assert (pages - free) * 1024 < 500_000
    assert entries(path)[0]["message"] == "by a person"


FILTERS = [
    Filter(),
    Filter(kinds=frozenset({"done", "lost"})),
    Filter(services=frozenset({"arm"})),
    Filter(services=frozenset({"camera", "nobody"})),
    Filter(text="100%_DONE"),
    Filter(since="2026-01-01T00:00:20Z", until="2026-01-01T00:00:40Z"),
    Filter(kinds=frozenset({"told"}), services=frozenset({"arm"}), after=30),
]


@pytest.mark.parametrize("filter", FILTERS)
@pytest.mark.parametrize("newest", [False, True])
def test_a_filter_means_the_same_in_the_file_and_in_memory(path, filter, newest):
    journal, dice = owned(path), random.Random(14)
    for second in range(60):
        names = dice.sample(["arm", "camera", "lidar"], 2)
        more = {"service": names[0]} if second % 2 else {"services": names, "shed": {"arm": "memory"}}
        text = dice.choice(["100%_done", "100x_done", "", "\udcff\0"])
        journal.append(f"2026-01-01T00:00:{second:02}Z", dice.choice(["done", "lost", "told"]), text, **more)
    for most in (0, 1, 7, 1000):
        near = journal.select(filter, most, newest)
        with reading(path) as database:
            stored = Journal(database).select(filter, most, newest)
        assert numbers(stored) == numbers(near)
    assert any(map(filter.matches, journal.since(0)))


# -- with a loop -------------------------------------------------------------------------------------------------


@pytest.fixture
def robot(tmp_path):
    found = RealRobot(tmp_path, "process", None)
    yield found
    found.close()


@pytest.mark.slow
def test_the_journal_replayed_is_what_the_engine_shows(robot):
    robot.declare({"camera": {"idle": {"action": "remove"}}, "lidar": {}, "arm": {"always_on": True}})
    robot.request("camera", "lidar")
    robot.wait(lambda: robot.active() == {"arm", "camera", "lidar"})
    robot.declare(
        {
            "camera": {"idle": {"action": "remove"}},
            "lidar": {},
            "arm": {"always_on": True, "container": {"environment": {"KEY": "hunter3"}}},
        }
    )
    robot.release()
    robot.settle()
    states: dict[str, str] = {}
    after = {"create": "created", "start": "running", "resume": "running", "pause": "paused", "stop": "exited"}
    for entry in entries(robot.state.journal):
        if entry["kind"] == "done" and entry["verb"] in after:
            states[entry["container"] or entry["service"]] = after[entry["verb"]]
        elif entry["kind"] == "done" and entry["verb"] == "remove":
            states.pop(entry["container"])
    there = {c.id[:12]: c.state for c in robot.containers()}
    assert {name: state for name, state in states.items() if name in there} == there
    assert not {name for name, state in states.items() if state == "running"} - there.keys()


@pytest.mark.slow
def test_a_pass_that_changes_nothing_writes_nothing(robot):
    robot.declare({"arm": {"always_on": True}, "camera": {}})
    robot.settle()
    robot.wait(lambda: robot.loop.tree.standing.code == "good")  # the end of its bake is news
    database, passes = robot.loop.recorder.history, robot.loop.passes
    robot.loop.wake()
    wait_for(lambda: robot.loop.passes > passes)  # what the last pass has found is written
    before, passes = database.changes, robot.loop.passes
    for _ in range(20):
        at = robot.loop.passes
        robot.loop.wake()
        wait_for(lambda at=at: robot.loop.passes > at)
    assert robot.loop.passes >= passes + 20
    assert database.changes == before


def test_crashes_are_counted_and_back_off_goes_on_over_a_restart_of_rorg(robot):
    robot.declare({"arm": {"always_on": True}})
    robot.wait(lambda: robot.active() == {"arm"})
    for number in (1, 2):
        robot.kill("arm")
        robot.wait(lambda n=number: robot.loop.running.memory.of("arm").crashes == n and robot.active() == {"arm"})
    robot.stop()
    said = len([e for e in entries(robot.state.journal) if e["kind"] == "crashed"])
    robot.start()
    robot.settle()
    step = robot.loop.running.memory.of("arm")
    assert (step.crashes, step.exits) == (2, 2)
    robot.kill("arm")
    robot.wait(lambda: robot.loop.running.memory.of("arm").crashes == 3)
    assert robot.loop.running.memory.of("arm").exits == 3
    robot.wait(lambda: len([e for e in entries(robot.state.journal) if e["kind"] == "crashed"]) == said + 1 == 3)


def test_lingering_goes_on_over_a_restart_of_rorg(robot):
    robot.declare({"camera": {"idle": {"linger": "1000s"}}})
    robot.request("camera")
    robot.wait(lambda: robot.active() == {"camera"})
    robot.release()
    robot.wait(lambda: robot.loop.running.memory.of("camera").unwanted_since is not None)
    since = robot.loop.running.memory.of("camera").unwanted_since
    robot.stop()
    robot.start()
    robot.wait(lambda: robot.loop.decision and robot.loop.decision.situation.observed.complete)
    assert abs(robot.loop.running.memory.of("camera").unwanted_since - since) < 0.1
    assert robot.active() == {"camera"}


@pytest.mark.slow
def test_revisions_are_written_down_with_what_became_of_them(robot):
    robot.declare({"arm": {"always_on": True, "container": {"environment": {"KEY": "hunter2"}}}})
    robot.settle()
    robot.declare({"arm": {"always_on": True, "container": {"environment": {"KEY": "hunter3"}}}})
    robot.settle()
    (robot.tree / "services" / "bad.yaml").write_text(
        "apiVersion: rorg/v1\nkind: Service\nmetadata: {name: bad}\nspecs: 1\n"
    )
    robot.wait(lambda: robot.loop.recorder.historian.revisions.last("refused"))
    robot.stop()
    robot.start()
    robot.wait(lambda: robot.loop.tree.errors)
    (robot.tree / "services" / "bad.yaml").unlink()
    robot.settle()
    with reading(robot.state.journal) as database:
        revisions = Revisions(database)
        found = {r.number: r.standing for r in revisions.list(10)}
        refused, last = revisions.last("refused"), revisions.last("good")
    assert refused.errors
    assert found[refused.number] == "refused"
    assert list(found.values()).count("refused") == 1
    assert last.services["arm"].digest == robot.container("arm").digest
    assert last.services["arm"].declared == robot.container("arm").declared
    assert "arm" in last.plan
    assert b"hunter" not in robot.state.journal.read_bytes()


def test_what_the_developer_asked_for_is_known_for_every_time(robot):
    robot.declare({"camera": {}, "lidar": {}})
    robot.request("camera", id="tour", reason="visitor")
    robot.wait(lambda: robot.active() == {"camera"})
    then = wall_clock()
    robot.request("lidar", id="map")
    robot.release("tour")
    robot.wait(lambda: robot.active() == {"lidar"})
    asked = robot.loop.recorder.historian.asked
    found = asked.at(then)
    assert [(r.id, r.services, r.reason) for r in found] == [("tour", ("camera",), "visitor")]
    assert [r.id for r in asked.at(wall_clock())] == ["map"]
    assert asked.at("2000-01-01T00:00:00Z") == ()


# -- followers ---------------------------------------------------------------------------------------------------


def test_numbers_go_on_over_a_restart(path):
    for number in range(3):
        journal = owned(path)
        journal.append(NOW, "told", f"{number}", person=number == 1)
        journal.database.close()
    assert [(e["seq"], e["message"]) for e in entries(path)] == [(1, "0"), (2, "1"), (3, "2")]


@pytest.mark.slow
@pytest.mark.parametrize("command", [("describe", "base"), ("events",), ("events", "-o", "json")])
def test_commands_say_why_they_cannot_read_it(shell, command):  # noqa: F811
    shell("apply", str(shell.tree), "--yes")
    for file in shell.state.glob("journal.db*"):
        file.unlink()
    (shell.state / "journal.db").write_text("no database")
    said = shell(*command, code=2).stderr
    assert "cannot read the journal" in said
    assert "Traceback" not in said


def test_the_disk_is_waited_for_by_one_thread_alone(path, monkeypatch):
    """The thread of maintenance brings what is written to the disk within its time."""
    monkeypatch.setattr(maintenance, "EVERY", 0.05)
    journal = owned(path)
    thread = kept(journal.database)
    thread.start()
    try:
        for number in range(5):
            journal.append(NOW, "told", f"{number}")
            wait_for(lambda: path.with_name("journal.db-wal").stat().st_size == 0, what="a checkpoint")
        copy = path.with_name("copy.db")
        shutil.copy(path, copy)
        assert numbers(entries(copy)) == [1, 2, 3, 4, 5], "without the log"
    finally:
        thread.stop()
        journal.database.close()


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
