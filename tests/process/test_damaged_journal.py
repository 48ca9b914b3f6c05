"""A robot whose journal is damaged starts without its history, says so, and keeps the damaged file."""

from __future__ import annotations

import json
import random
import shutil
import sqlite3
import time
from contextlib import closing, suppress
from pathlib import Path

import pytest
from commands import run
from common import wait_for
from histories import entries, integrity, owned, wall
from robots import RealRobot
from rorg_client import Client, Error
from rorg_process import RorgProcess

from rorg.errors import Exit, Invalid, Missing
from rorg.history import queries
from rorg.history.database import Database, reading
from rorg.history.durations import learned_workload
from rorg.history.journal import Journal, fault
from rorg.history.maintenance import Maintenance
from rorg.history.meta_requests import Asked
from rorg.history.request_log import RequestLog
from rorg.history.retention import Retention
from rorg.history.revisions import Made, Revision, Revisions
from rorg.history.runs import Runs
from rorg.history.usage import Measured, UsageTable
from rorg.model.catalog import Request
from rorg.store.state_dir import StateDir

SERVICES = {
    "arm": {"idle": {"action": "pause", "linger": "0s"}},
    "base": {"needs": ["arm"], "idle": {"action": "stop", "linger": "0s"}},
    "camera": {"command": ["sh", "-c", "exit 3"]},
}
QUESTIONS = (
    "/v1/status",
    "/v1/services/arm/why",
    "/v1/events?tail=1000",
    "/v1/history",
    "/v1/history/1",
    "/v1/history/1/diff/2",
    "/v1/history/export",
    "/v1/timeline/base?since=2020-01-01T00:00:00Z",
    "/v1/requested?since=2020-01-01T00:00:00Z",
    "/v1/measured?since=2020-01-01T00:00:00Z",
    "/v1/measured/slots?since=2020-01-01T00:00:00Z",
)
COMMANDS = (("events",), ("history",), ("timeline",), ("get",), ("doctor",))
TRIES, PROCESSES, OFFLINE = 200, 8, 20
LONG_AGO = "2020-01-01T00:00:00Z"


@pytest.fixture(scope="module")
def lively(tmp_path_factory) -> Path:
    """The folder of a robot that ran, was changed, refused a change and lost a service."""
    robot = RealRobot(tmp_path_factory.mktemp("lively"), "process", None, with_server=True)
    try:
        robot.declare(SERVICES)
        for number in range(6):
            robot.client().call("PUT", f"/v1/requests/tour{number}", {"services": ["base"], "reason": "fünf Gäste"})
            robot.wait(lambda: "base" in robot.active())
            robot.client().call("DELETE", f"/v1/requests/tour{number}")
            robot.wait(lambda: "base" not in robot.active())
        robot.request("camera")
        robot.wait(lambda: any("camera ended with exit code 3" in line for line in robot.lines))
        robot.release()
        robot.declare({**SERVICES, "arm": {**SERVICES["arm"], "container": {"environment": {"SPEED": "2"}}}})
        robot.wait(lambda: len(robot.client().call("GET", "/v1/history")) > 1)
        (robot.tree / "services/wrong.yaml").write_text("kind: [")
        robot.wait(lambda: robot.client().call("GET", "/v1/history")[0]["standing"] == "refused")
        (robot.tree / "services/wrong.yaml").unlink()
        robot.settle()
        robot.stop()
    finally:
        robot.close()
    assert integrity(robot.state.journal) == "ok"
    return robot.state.path.parent


def flipped(content: bytes, seed: int) -> bytes:
    """The content with one to twenty wrong bytes."""
    dice, damaged = random.Random(seed), bytearray(content)
    for _ in range(dice.randint(1, 20)):
        damaged[dice.randrange(len(damaged))] ^= dice.randrange(1, 256)
    return bytes(damaged)


def damaged_copy(lively: Path, seed: int, path: Path) -> None:
    for file in path.parent.glob("journal.*"):
        file.unlink()
    path.write_bytes(flipped((lively / "state/journal.db").read_bytes(), seed))


def ask_everything(loop) -> None:
    """What the API answers of the history."""
    journal, revisions, until = loop.recorder.journal, loop.recorder.historian.revisions, wall()
    for revision in queries.listed(revisions, 100):
        if found := revisions.get(revision["number"]):
            queries.full(found)
    json.dumps(list(queries.records(journal, revisions)))
    for service in SERVICES:
        queries.timeline(journal, service, LONG_AGO, until)
    with suppress(Missing):
        RequestLog(journal).between(LONG_AGO, until)
    learned_workload("", journal.since(0))
    table = UsageTable(loop.recorder.history)
    table.since(LONG_AGO), table.slots(LONG_AGO, until)


@pytest.mark.slow
def test_a_robot_starts_and_answers_whatever_bytes_are_wrong(lively, tmp_path):
    shutil.copytree(lively / "tree", tmp_path / "tree")
    robot = RealRobot(tmp_path, "process", None)
    try:
        for seed in range(TRIES):
            damaged_copy(lively, seed, robot.state.journal)
            robot.start()
            robot.wait(lambda: robot.loop.decision)
            ask_everything(robot.loop)
            robot.stop()
            assert integrity(robot.state.journal) == "ok", f"seed {seed}"
            assert entries(robot.state.journal), f"seed {seed}"
    finally:
        robot.close()


def answer(client: Client, question: str) -> str:
    """The code of the error that a question gets; empty for an answer."""
    try:
        client.call("GET", question)
    except Error as error:
        return error.code
    return ""


@pytest.mark.slow
def test_rorg_run_starts_and_serves_with_a_damaged_journal(lively, tmp_path):
    shutil.copytree(lively / "tree", tmp_path / "tree")
    process = RorgProcess(tmp_path, SERVICES)
    process.state.mkdir()
    try:
        for seed in range(TRIES, TRIES + PROCESSES):
            damaged_copy(lively, seed, path := process.state / "journal.db")
            if seed == TRIES:
                sound = (lively / "state/journal.db").read_bytes()
                path.write_bytes(sound.replace(b"CREATE TABLE run (", b"CREATE TABLE run \xa8"))
            process.start()
            client = process.client(patience=60.0)
            client.call("GET", "/v1/status")
            for question in QUESTIONS:
                assert answer(client, question) in ("", "not-found"), f"seed {seed}: {question}"
            if seed == TRIES:
                wait_for(lambda: "journal-damaged" in {e["kind"] for e in client.events(tail=100)}, 20, "the event")  # noqa: B023
            process.stop()
            assert process.process.returncode == 0
            checks = run(["doctor", "--state-dir", str(process.state), "--engine", "process", "-o", "json"]).stdout
            (check,) = [check for check in json.loads(checks) if check["check"] == "journal"]
            aside = sorted(map(str, process.state.glob("journal.damaged-*.db")))
            assert check["status"] == ("warning" if aside else "ok"), f"seed {seed}: {check}"
            assert all(path in check["message"] for path in aside)
    finally:
        process.close()


@pytest.mark.slow
def test_commands_without_a_running_rorg_answer_or_say_in_one_line_why_not(lively, tmp_path):
    state = StateDir(tmp_path / "state").prepare()
    for seed in range(OFFLINE):
        damaged_copy(lively, seed, state.journal)
        for words in COMMANDS:
            done = run([*words, "--state-dir", str(state.path), "--engine", "process"], cwd=lively / "tree")
            assert done.returncode != Exit.INTERNAL, f"seed {seed}: {words}: {done.stderr}"
            assert "Traceback" not in done.stderr
            assert done.returncode in (0, Exit.NOT_READY) or len(done.stderr.splitlines()) == 1, done.stderr


NOW = "2026-11-22T12:00:00.000000Z"
READ = {
    "entry": lambda database: Journal(database).check(lambda: None),
    "revision": lambda database: Revisions(database).last(),
    "made": lambda database: Revisions(database).last(),
    "run": lambda database: Runs(database).read(),
    "asked": lambda database: list(Asked(database).between("", wall())),
    "usage": lambda database: (UsageTable(database).since(""), UsageTable(database).slots("", wall())),
}
WRONG_VALUES = [
    ("entry", "message = CAST(x'64ff6e65' AS TEXT)"),
    ("entry", "message = 'ready'"),
    ("entry", "at = 'yesterday'"),
    ("entry", "seq = seq + 1000"),
    ("entry", "seq = -seq"),
    ("entry", "kind = x'00'"),
    ("entry", "more = '{', checksum = NULL"),
    ("entry", "more = '[1]', checksum = NULL"),
    ("revision", "number = -number"),
    ("revision", "number = number + 1000000000"),
    ("revision", "at = 'yesterday'"),
    ("revision", "errors = '[1]'"),
    ("revision", "errors = '{'"),
    ("revision", "standing = x'00'"),
    ("made", "image = x'00'"),
    ("run", "text = '{'"),
    ("run", "text = '[]'"),
    ("asked", "at = '2026-11-22T12:00:x'"),
    ("asked_text", "text = '[[1]]'"),
    ("asked_text", "text = '7'"),
    ("usage", "cpu = -1e300"),
    ("usage", "seconds = 9e999"),
    ("usage", "hour = '2026-11-22Tnoon'"),
    ("usage", "peak = x'00'"),
]


def filled(path: Path) -> None:
    """A history with a row in each table."""
    database = Database(path, wall)
    Journal(database).append(NOW, "told", "it is ready", service="arm")
    Revisions(database).begin(Revision(0, NOW, "f", services={"arm": Made("v1:1", "{}")}))
    Runs(database).write({"arm": "{}"}, ())
    Asked(database).note(NOW, [Request("tour", "developer", ("arm",))])
    UsageTable(database).note(NOW, [Measured("arm", "run", 60.0, 1.0, 1 << 20)])
    database.close()


@pytest.mark.parametrize(("table", "change"), WRONG_VALUES)
def test_a_value_that_rorg_does_not_write_is_damage(tmp_path, table, change):
    path, read = tmp_path / "journal.db", READ[table.removesuffix("_text")]
    filled(path)
    with reading(path) as database:
        read(database)
    with closing(sqlite3.connect(path)) as connection, connection:
        assert connection.execute(f"UPDATE {table} SET {change}").rowcount == 1
    content = path.read_bytes()
    with reading(path) as database, pytest.raises(Invalid, match=r"cannot read the journal: .*journal\.db"):
        read(database)
    database = Database(path, wall)
    read(database)
    assert [kind for kind, _ in database.take_notes()] == ["journal-damaged"]
    (aside,) = path.parent.glob("journal.damaged-*.db")
    assert aside.read_bytes() == content
    assert not fault(path)
    database.close()


def test_damage_that_is_found_while_rorg_runs_costs_the_past_but_nothing_that_is_in_force(tmp_path):
    """The next revision, request and memory are written whole into the new file, with their next numbers."""
    path = tmp_path / "journal.db"
    filled(path)
    database = Database(path, wall)
    journal, revisions, runs, asked = Journal(database), Revisions(database), Runs(database), Asked(database)
    services, request = {"arm": Made("v1:1", "{}"), "base": Made("v1:2", "{}")}, Request("tour", "developer", ("arm",))
    assert revisions.in_force().services.keys() == {"arm"}
    assert runs.read() == {"arm": {}}
    asked.note(NOW, [request])
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE entry SET message = CAST(x'64ff6e65' AS TEXT)")
    Maintenance(database, lambda *_: None, Retention, time.time).look()
    journal.append(NOW, "told", "it goes on")
    assert revisions.begin(Revision(0, NOW, "g", services=services)).number == 2
    runs.write({"base": "{}"}, ())
    asked.note(NOW, [request])
    assert [entry["seq"] for entry in entries(path)] == [2]
    with reading(path) as found:
        assert Revisions(found).get(2).services.keys() == services.keys()
        assert Runs(found).read() == {"arm": {}, "base": {}}
        assert [r.id for r in Asked(found).at(wall())] == ["tour"]
    database.close()


def test_a_file_of_an_older_rorg_is_read_and_upgraded(tmp_path):
    path = tmp_path / "journal.db"
    filled(path)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("ALTER TABLE entry DROP COLUMN checksum")
        connection.execute("ALTER TABLE revision DROP COLUMN proven_at")
        connection.execute("DROP TABLE verdict")
        connection.execute("PRAGMA user_version = 2")
    assert [entry["message"] for entry in entries(path)] == ["it is ready"]
    journal = owned(path)
    journal.append(NOW, "told", "it goes on")
    journal.check(lambda: None)
    assert [entry["message"] for entry in entries(path)] == ["it is ready", "it goes on"]
    assert not journal.database.take_notes()
    journal.database.close()
