"""What is told of the history: events and their folding, timelines, revisions, and the export in both forms."""

from __future__ import annotations

import importlib.util
import json
import re
import subprocess
import sys
from datetime import UTC, datetime, timedelta
from pathlib import Path

import commands
import pytest
from common import ROOT
from hypothesis import given, settings
from hypothesis import strategies as st
from robots import RealRobot
from tools import tool

from rorg.api import records as protobuf
from rorg.client import Forbidden
from rorg.errors import Missing
from rorg.history import queries
from rorg.history.database import Database
from rorg.history.journal import Journal
from rorg.history.repeats import folded
from rorg.history.revisions import Made, Revision, Revisions, parse

PROTO = ROOT / "schemas/journal.proto"
PAGE = ROOT / "docs/how-to/history.md"
BEGIN = datetime(2026, 1, 31, 10, tzinfo=UTC)


def at(seconds: float) -> str:
    return (BEGIN + timedelta(seconds=seconds)).isoformat(timespec="microseconds").replace("+00:00", "Z")


# -- protocol buffers ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def reader(tmp_path_factory):
    """The module of the page, over what protoc makes of the schema."""
    folder = tmp_path_factory.mktemp("reader")
    subprocess.run([tool("protoc"), "-I", PROTO.parent, f"--python_out={folder}", PROTO.name], check=True)
    (folder / "reading.py").write_text(re.search(r"```python\n(.*?)```", PAGE.read_text(), re.S)[1])
    sys.path.insert(0, str(folder))
    try:
        spec = importlib.util.spec_from_file_location("reading", folder / "reading.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(folder))
    return module


def told(message) -> dict:
    """What a message of the generated reader says, as a plain value."""
    found = {}
    for field, value in message.ListFields():
        if field.message_type and field.message_type.GetOptions().map_entry:
            found[field.name] = {k: told(v) if hasattr(v, "ListFields") else v for k, v in value.items()}
        elif hasattr(value, "ListFields"):
            found[field.name] = told(value)
        else:
            found[field.name] = value if isinstance(value, str | int | float | bool) else list(value)
    if "more" in found:
        found |= json.loads(found.pop("more"))
    return found


def without_empty(value):
    """An empty list is no list to protocol buffers."""
    if not isinstance(value, dict):
        return value
    return {k: without_empty(v) for k, v in value.items() if v not in ([], {}, None)}


def read_back(reader, folder: Path, records: list[dict]) -> list[dict]:
    path = folder / "export.pb"
    path.write_bytes(b"".join(map(protobuf.record, records)))
    return [told(record) for record in reader.records(path)]


TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=200)
VALUES = {
    "string": TEXT,
    "int64": st.integers(-(1 << 63), (1 << 63) - 1),
    "double": st.floats(allow_nan=False),
    "bool": st.booleans(),
    "repeated string": st.lists(TEXT, max_size=5),
    "map<string, string>": st.dictionaries(TEXT, TEXT, max_size=4),
}


def of(message: protobuf.Message):
    kinds = {**VALUES, "map<string, Made>": st.dictionaries(TEXT, st.deferred(lambda: of(protobuf.MADE)), max_size=2)}
    first, *rest = (field for field in message.fields if field.name != protobuf.MORE)
    fields = {field.name: kinds[field.type] for field in rest}
    return st.fixed_dictionaries({first.name: kinds[first.type]}, optional=fields)


WHOLE = st.integers(-(1 << 53), 1 << 53)
"""Numbers that a double has, too."""
STRANGE = st.dictionaries(st.sampled_from(["later", "kind", "services", "seconds"]), st.none() | WHOLE | TEXT)
RECORDS = of(protobuf.REVISION).map(lambda value: {"revision": value}) | st.tuples(of(protobuf.EVENT), STRANGE).map(
    lambda both: {"event": {**both[0], **both[1]}}
)


@settings(max_examples=60, deadline=None)
@given(records=st.lists(RECORDS, max_size=4))
def test_whatever_is_on_record_is_read_back_by_a_generated_reader(reader, tmp_path_factory, records):
    folder = tmp_path_factory.getbasetemp()
    assert [without_empty(r) for r in read_back(reader, folder, records)] == [without_empty(r) for r in records]


def test_the_schema_is_current_and_no_number_is_given_twice():
    assert PROTO.read_text() == protobuf.schema(), "make schemas"
    for message in protobuf.MESSAGES.values():
        numbers = [field.number for field in message.fields]
        assert len(set(numbers)) == len(numbers), message.name


def test_every_field_of_the_api_has_one_in_the_schema():
    from rorg.api.history_models import MadeView, RevisionDetail
    from rorg.api.status_models import EventView

    for model, message in ((EventView, protobuf.EVENT), (RevisionDetail, protobuf.REVISION), (MadeView, protobuf.MADE)):
        assert set(model.model_fields) <= {field.name for field in message.fields}, message.name


# -- folding ---------------------------------------------------------------------------------------------------


def entry(seq: int, kind: str, message: str, **more) -> dict:
    return {"seq": seq, "at": at(seq), "kind": kind, "message": message, **more}


def test_a_service_that_fails_all_day_has_one_line_for_each_thing_that_it_says():
    entries, seq = [entry(0, "request", "request 'tour-1' of developer: arm")], 1
    for crash in range(14):
        entries.append(entry(seq, "done", f"> start arm: done in {crash} ms", service="arm"))
        text = f"arm ended with exit code 3 (unexpected exit {crash + 1} since rorg started)"
        entries.append(entry(seq + 1, "crashed", text, service="arm", crashes=crash + 1))
        seq += 2
    entries.append(entry(seq, "request", "request 'tour-2' of developer: arm"))
    lines = folded(entries)
    assert [(group.times, group.last["seq"], group.since) for group in lines] == [
        (1, 0, at(0)),
        (14, 27, at(1)),
        (14, 28, at(2)),
        (1, 29, at(29)),
    ]


def test_only_what_says_the_same_but_for_times_is_folded():
    texts = ["exit code 1", "exit code 139", "tour-1", "tour-2", "next try in 2 s", "next try in 8 s"]
    lines = folded(entry(n, "told", text) for n, text in enumerate(texts))
    assert [group.last["message"] for group in lines] == [*texts[:4], "next try in 8 s"]
    apart = [entry(n, "told", f"line-{n % 20}") for n in range(40)]
    assert len(folded(apart, window=12)) == 40, "only lines that are near are compared"
    assert len(folded(apart, window=20)) == 20


# -- timelines -------------------------------------------------------------------------------------------------


@pytest.fixture
def history(tmp_path):
    found = Database(tmp_path / "journal.db", lambda: at(0))
    yield found
    found.close()


def spans_of(journal: Journal, since: float, until: float) -> list[tuple]:
    found = queries.timeline(journal, "arm", at(since), at(until))
    return [(s["state"], s["begin"], s["end"], s["why"], s["who"]) for s in found["spans"]]


def test_a_timeline_says_from_when_to_when_why_and_who(history):
    journal = Journal(history)

    def state(seconds: float, word: str, reason: str, *requests: str) -> None:
        asked = {"requests": list(requests)} if requests else {}
        journal.append(at(seconds), "state", f"arm is {word}", service="arm", state=word, reason=reason, **asked)

    def person(seconds: float, kind: str, author: str, **about) -> None:
        journal.append(at(seconds), kind, f"{kind} '{about.get('request', '')}'", True, author=author, **about)

    person(0, "request", "ann", service="developer", request="tour")
    state(1, "running", "requested by developer (tour)", "developer/tour")
    state(2, "ready", "requested by developer (tour)", "developer/tour")
    journal.append(at(3), "crashed", "arm ended with exit code 3", service="arm", crashes=1)
    state(3, "exited", "ended with exit code 3")
    state(4, "ready", "requested by developer (tour)", "developer/tour")
    person(5, "restart", "bob", services=["arm"])
    journal.append(at(6), "done", "# stop arm", service="arm", verb="stop", reason="restart requested")
    state(6, "exited", "requested by developer (tour)", "developer/tour")
    state(7, "ready", "requested by developer (tour)", "developer/tour")
    person(8, "release", "eve", service="developer", request="tour")
    person(8, "release", "nobody", service="developer", request="other")
    state(9, "paused", "not wanted")
    journal.append(at(20), "found", "found", services=["arm"], states={"arm": "exited"})

    asked = "requested by developer (tour)"
    assert spans_of(journal, -5, 30) == [
        ("running", at(1), at(2), asked, "ann"),
        ("ready", at(2), at(3), asked, "ann"),
        ("exited", at(3), at(4), "ended with exit code 3", ""),
        ("ready", at(4), at(6), asked, "ann"),
        ("exited", at(6), at(7), "restart requested", "bob"),
        ("ready", at(7), at(9), asked, "bob"),
        ("paused", at(9), at(20), "not wanted", "eve"),
        ("exited", at(20), None, "already so when rorg began", ""),
    ]
    assert spans_of(journal, 2.5, 3.5) == [
        ("ready", at(2.5), at(3), asked, "ann"),
        ("exited", at(3), None, "ended with exit code 3", ""),
    ], "the state of before the time is known"
    assert queries.timeline(journal, "camera", at(0), at(30))["spans"] == []


def test_the_chart_shows_each_state_in_its_part_of_the_time():
    from rorg.cli.timeline import chart

    spans = [
        {"state": "ready", "begin": at(0), "seconds": 75.0},
        {"state": "exited", "begin": at(75), "seconds": 0.1},
        {"state": "ready", "begin": at(75.1), "seconds": 24.9},
    ]
    lines = chart(at(100), spans, 114)
    assert lines[0] == f"ready  |{'#' * 100}| 100%"
    assert lines[1] == f"exited |{' ' * 75}#{' ' * 24}|   0%"
    assert lines[2].split() == ["2026-01-31", "10:00:00", "2026-01-31", "10:01:40"]


# -- revisions -------------------------------------------------------------------------------------------------


def made(number: int, **options) -> Made:
    declared = json.dumps(
        {"image": f"arm:{number}", "command": ["run"], "environment": {"KEY": f"hash{number}"}, **options}
    )
    return Made(f"digest{number}", declared, f"arm:{number}", f"sha256:{number}", f"edition{number}")


def begun(revisions: Revisions, commit: str, **services: Made) -> Revision:
    return revisions.begin(Revision(0, at(0), f"tree {commit}", commit=commit, services=services))


def test_a_change_that_the_full_disk_does_not_have_is_blamed_on_no_earlier_revision(history, monkeypatch):
    revisions = Revisions(history)
    begun(revisions, "a" * 40, arm=made(1))
    monkeypatch.setattr(history, "write", lambda change, keep=True: False)
    second = begun(revisions, "b" * 40, arm=made(2))
    assert revisions.changed_in("arm", second.number, "edition2") == 0
    assert revisions.changed_in("arm", second.number, "edition1") == 1


def test_two_revisions_are_compared_field_by_field_with_secrets_masked(history):
    revisions = Revisions(history)
    old = begun(
        revisions, "a" * 40, arm=made(1, command=["run", "--password", "geheim"]), camera=made(2), lidar=made(3)
    )
    new = begun(revisions, "b" * 40, arm=made(4), lidar=made(3), map=made(5))
    found = queries.compared(revisions.get(old.number), revisions.get(new.number))
    assert [(c["service"], c["change"]) for c in found["services"]] == [
        ("arm", "changed"),
        ("camera", "removed"),
        ("map", "added"),
    ]
    assert [f["text"] for f in found["services"][0]["fields"]] == [
        "command: run --password '***' -> run",
        "environment.KEY changed",
        "image: arm:1 -> arm:4",
    ]
    assert "geheim" not in json.dumps([found, queries.full(revisions.get(old.number))])
    assert "hash1" not in json.dumps(queries.full(revisions.get(old.number)))
    assert queries.compared(new, new)["services"] == []


def test_an_image_that_was_built_anew_and_content_that_changed_are_told(history):
    from dataclasses import replace

    one, revisions = made(1), Revisions(history)
    for other, text in (
        (replace(one, image_id="sha256:9"), "image_id: sha256:1 -> sha256:9"),
        (replace(one, edition="other"), "probes or mounted files changed"),
        (replace(one, image_id=""), None),
    ):
        old, new = begun(revisions, "a", arm=one), begun(revisions, "b", arm=other)
        services = queries.compared(old, new)["services"]
        assert [f["text"] for c in services for f in c["fields"]] == ([text] if text else [])


def test_a_revision_is_named_by_its_number_else_as_git_says(history):
    revisions = Revisions(history)
    commits = [f"{n}{'abcdef0' * 6}"[:40] for n in range(1, 4)]
    for commit in commits:
        begun(revisions, commit)
    names = {"tag": commits[0], "2": commits[2], "000009": commits[1]}

    def named(text: str) -> int:
        return queries.resolve(text, revisions, lambda name: names.get(name, "")).number

    assert [named(text) for text in ("1", "2", "tag", commits[2], commits[1][:10], "000009")] == [1, 2, 1, 3, 2, 2]
    assert parse("12345678", revisions) == "12345678"
    for text in ("9", "HEAD", "", "-1", "--all", "%", "\u0661", "9999999"):
        with pytest.raises(Missing):
            named(text)


# -- a real robot ----------------------------------------------------------------------------------------------

SERVICES = {
    "camera": {"always_on": True},
    "arm": {"ready": {"delay": "100ms"}},
    "bad": {"always_on": True, "command": ["sh", "-c", "exit 3"], "may_request": ["arm"]},
}


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    found = RealRobot(tmp_path_factory.mktemp("robot"), "process", None, with_server=True)
    found.declare(SERVICES)
    found.wait(lambda: "camera" in found.active())
    found.client().call("PUT", "/v1/requests/tour", {"services": ["arm"]})
    found.wait(lambda: found.loop.decision.memory.of("arm").ready)
    found.wait(lambda: sum("unexpected exit" in line for line in found.log()) >= 2)
    found.client().call("DELETE", "/v1/requests/tour")
    found.wait(lambda: "arm" not in found.active())
    yield found
    found.close()


def said(robot, *words: str, code: int = 0) -> str:
    environment = {"RORG_STATE_DIR": str(robot.state.path), "RORG_ENGINE": "process"}
    return commands.rorg(*words, code=code, **environment).stdout


@pytest.mark.slow
def test_the_same_is_told_with_a_running_rorg_and_without(robot, reader, tmp_path):
    """The bad service would go on to fail: it is looked at up to a time."""
    robot.client().suspend(3600, "so that all stands still")
    robot.wait(lambda: robot.loop.decision.situation.suspended and not robot.loop.decision.memory.in_flight)
    generation = robot.loop.generations.changed()
    robot.loop.wake()
    robot.wait(lambda: robot.loop.generations.reached(generation))
    entries = robot.loop.recorder.journal.after(0, 10_000)
    until = entries[-1]["at"]
    lines = [
        ["events", "--until", until],
        ["events", "--until", until, "--kind", "crashed,state", "--service", "bad,arm", "--no-fold", "-o", "wide"],
        ["events", "--since", entries[5]["at"], "--until", until, "--grep", "EXIT CODE 3", "-o", "json"],
        ["events", "--since", "2026-01-01", "--until", until, "--tail", "3", "-o", "name"],
        ["timeline", "arm", "--until", until, "--since", entries[0]["at"]],
        ["timeline", "arm", "--until", until, "--since", entries[0]["at"], "-o", "json"],
        ["history"],
        ["history", "-o", "json"],
        ["history", "export"],
    ]
    served = [said(robot, *line) for line in lines]
    assert served[0].count("unexpected exit") == 1, "what repeats is folded"
    assert re.search(r"\(x \d+ since \d\d:\d\d:\d\d\)$", served[0], re.MULTILINE)
    assert "camera" not in served[1]
    assert {json.loads(line)["service"] for line in served[2].splitlines()} == {"bad"}
    assert served[3].split() == [str(e["seq"]) for e in entries[-3:]]
    author = next(e["author"] for e in entries if e["kind"] == "request")
    states = [(s["state"], s["who"]) for s in json.loads(served[5])["spans"]]
    assert ("ready", author) in states
    assert states[-1] in (("exited", author), ("paused", author)), "who released it"
    exported = [json.loads(line) for line in served[8].splitlines()]
    assert [r["event"] for r in exported if "event" in r][: len(entries)] == entries

    pieces = tmp_path / "robot.pb"
    said(robot, "history", "export", "--format", "protobuf", "--file", str(pieces))
    read = [without_empty(told(record)) for record in reader.records(pieces)]
    assert read[: len(exported)] == [without_empty(record) for record in exported]

    with pytest.raises(Forbidden):
        robot.client("bad").call("GET", "/v1/history")
    robot.stop()
    for line, before in zip(lines[:-1], served, strict=False):
        assert said(robot, *line) == before, line


def git(folder: Path, *words: str) -> str:
    who = ("-c", "user.name=Ann", "-c", "user.email=ann@example.org")
    return subprocess.run(["git", *who, *words], cwd=folder, check=True, capture_output=True, text=True).stdout.strip()


def commit(robot, subject: str, services: dict) -> str:
    """Declares services in a commit, and waits until that has proven good."""
    robot.declare(services)
    git(robot.tree, "add", "--all")
    git(robot.tree, "commit", "--quiet", "--message", subject)
    found = git(robot.tree, "rev-parse", "HEAD")
    revisions = robot.loop.recorder.historian.revisions
    robot.wait(lambda: (r := revisions.last()) and (r.commit, r.dirty, r.standing) == (found, False, "good"))
    return found


def test_an_export_from_an_rorg_that_is_not_there_says_so(tmp_path):
    done = commands.rorg("history", "export", code=3, RORG_SOCKET=str(tmp_path / "none.sock"))
    assert done.stderr.startswith(f"rorg: cannot reach rorg on {tmp_path}/none.sock: ")


@pytest.mark.slow
def test_revisions_are_shown_and_compared_by_number_and_by_commit(tmp_path):
    robot = RealRobot(tmp_path, "process", None, with_server=True)
    try:
        robot.tree.mkdir(exist_ok=True)
        git(robot.tree, "init", "--quiet", "--initial-branch", "main/line")
        secret = ["sleep", "600", "--password", "geheim"]
        first = commit(robot, "First", {"camera": {"always_on": True}, "arm": {"command": secret}})
        git(robot.tree, "tag", "demo")
        last = commit(robot, "Second", {"camera": {"always_on": True, "command": ["sleep", "601"]}})
        (robot.tree / "services" / "bad.yaml").write_text("kind: Service\n")
        robot.wait(lambda: robot.loop.recorder.historian.revisions.last().standing == "refused")
        lines = [
            ["history", "-o", "json"],
            ["history"],
            ["history", "show", "demo"],
            ["history", "show", first[:8], "-o", "json"],
            ["history", "diff", "demo", "HEAD"],
            ["history", "diff", "HEAD~1", "main/line", "-o", "json"],
            ["history", "export"],
        ]
        served = [said(robot, *line) for line in lines]
        refused, second, *others = json.loads(served[0])
        assert (refused["standing"], "bad.yaml" in refused["errors"][0]) == ("refused", True)
        assert [second[k] for k in ("commit", "author", "subject", "standing")] == [last, "Ann", "Second", "good"]
        number = next(r["number"] for r in others if r["commit"] == first)
        assert "bad.yaml" in said(robot, "history", "show", str(refused["number"]))
        assert re.search(rf"{last[:10]} +Ann +good +Second$", served[1], re.MULTILINE)
        assert served[2].startswith(f"revision {number}: ")
        shown = json.loads(served[3])
        assert (shown["number"], set(shown["services"])) == (number, {"camera", "arm"})
        assert [line.split()[:2] for line in served[4].splitlines()] == [["-", "arm"], ["~", "camera"]]
        assert served[4].endswith("-> sleep 601\n")
        assert [c["change"] for c in json.loads(served[5])["services"]] == ["removed", "changed"]
        assert "geheim" not in "".join(served)
        robot.stop()
        assert [said(robot, *line) for line in lines] == served
    finally:
        robot.close()
