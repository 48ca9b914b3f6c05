"""Whatever lies in the state directory: a loop begins and commands answer, or say why not. What is told is never a
traceback or an internal error, and nothing hangs."""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import commands
import pytest
from fuzzing import Case, fuzz
from mutations import mutated_text, mutated_value
from robots import RealRobot, write_tree

from rorg.cli import main
from rorg.core.decide import Decision
from rorg.daemon.wiring import make_loop
from rorg.engines.make import make_engine
from rorg.errors import Invalid, RorgError
from rorg.store.files import MOST
from rorg.store.requests_file import SPARE
from rorg.store.state_dir import StateDir

COMMANDS = (
    ("get",),
    ("get", "requests", "-o", "json"),
    ("get", "camera", "-o", "wide"),
    ("why", "lidar"),
    ("events",),
    ("describe", "camera"),
    ("diff",),
    ("graph",),
    ("request", "camera"),
    ("release", "tour"),
    ("hold", "lidar", "10s"),
    ("suspend", "10s"),
    ("restart", "camera"),
    ("logs", "camera"),
    ("validate",),
    ("wait", "camera", "--timeout", "0.1s"),
)
SERVICES = {"camera": {"always_on": True}, "lidar": {}, "radar": {"command": ["sh", "-c", "echo radar; exit 1"]}}


@pytest.fixture(scope="module")
def left(tmp_path_factory) -> Iterator[tuple[Path, Path]]:
    """(tree, state directory) as an rorg has left them that was asked for much."""
    folder = tmp_path_factory.mktemp("left")
    robot = RealRobot(folder, "process", None)
    try:
        robot.declare({**SERVICES, "old": {}}, groups={"eyes": {"services": ["camera", "lidar"]}})
        robot.request("lidar", "old", id="tour", reason="a visitor", ttl=3600.0)
        robot.hold("radar", 3600, "maintenance")
        robot.wait(lambda: robot.active() == {"camera", "lidar", "old"})
        write_tree(robot.tree, SERVICES, groups={"eyes": {"services": ["camera", "lidar"]}})
        robot.wait(lambda: robot.status().get("withheld"))
        robot.stop()
        for container in robot.containers():
            robot.engine.stop(container.id, "SIGKILL", 5.0)
        robot.state.path.joinpath(SPARE).write_bytes(robot.state.requests.read_bytes())
        yield robot.tree, robot.state.path
    finally:
        robot.close()


def spoil_text(path: Path, chance: random.Random) -> None:
    content = path.read_bytes()
    at = chance.randrange(len(content) + 1)
    kind = chance.randrange(6)
    if kind == 0:
        content = b""
    elif kind == 1:
        content = content[:at]
    elif kind == 2:
        content = content[:at] + chance.randbytes(chance.choice((1, 8, 200))) + content[at + chance.choice((0, 8)) :]
    elif kind == 3:
        content = bytes(len(content))  # as a file system that lost power leaves it
    else:
        content = mutated_text(content.decode(), chance).encode(errors="surrogatepass")
    path.write_bytes(content)


def spoil_value(path: Path, chance: random.Random) -> None:
    """One value of the JSON in it."""
    lines = path.read_text().splitlines() or [""]
    which = chance.randrange(len(lines))
    try:
        value = json.loads(lines[which])
    except ValueError:
        return spoil_text(path, chance)
    for _ in range(chance.choice((1, 1, 3))):
        value = mutated_value(value, chance)
    lines[which] = json.dumps(value)
    return path.write_text("\n".join(lines) + "\n")


def another(make: Callable[[Path], object]) -> Callable[[Path, random.Random], None]:
    def spoil(path: Path, _: random.Random) -> None:
        path.unlink()
        make(path)

    return spoil


def huge(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(MOST + 1)


ODD = {
    "a directory": another(Path.mkdir),
    "a pipe": another(os.mkfifo),
    "a link to itself": another(lambda path: path.symlink_to(path.name)),
    "a link to nothing": another(lambda path: path.symlink_to("nothing")),
    "a link to a device without end": another(lambda path: path.symlink_to("/dev/zero")),
    "a link to a directory": another(lambda path: path.symlink_to("/")),
    "huge": another(huge),
    "gone": another(lambda path: None),
    "empty": another(Path.touch),
    "binary": another(lambda path: path.write_bytes(bytes(range(256)) * 8)),
    "nested": another(lambda path: path.write_text("[" * 200_000)),
}


def files(state: Path) -> list[Path]:
    return sorted(p for p in state.rglob("*") if p.is_file() and "run" not in p.relative_to(state).parts[:1])


def spoil(case: Case, state: Path) -> None:
    """One file or two of the state directory."""
    chance, told = case.chance, []
    for path in chance.sample(files(state), chance.choice((1, 1, 1, 2))):
        odd = chance.choice(list(ODD)) if chance.random() < 0.25 else ""
        how = ODD[odd] if odd else spoil_value if path.suffix in (".json", ".jsonl") else spoil_text
        how(path, chance)
        told.append(f"{path.relative_to(state)}: {odd or path.read_bytes()!r}")
    case.text = "\n".join(told)


def said(*words: str) -> tuple[int, str]:
    """Exit code of a command and what it says, in this process."""
    out, sys.argv = io.TextIOWrapper(io.BytesIO(), write_through=True), ["rorg", *words]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        try:
            main.run()
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
    return code, out.buffer.getvalue().decode(errors="replace")  # a log is passed on as it is


def commands_answer(case: Case, tree: Path, state: Path) -> None:
    for words in case.chance.sample(COMMANDS, 3):
        more = ("--state-dir", str(state)) if words != ("validate",) else (str(tree),)
        code, text = said(*words, *more)
        assert code != 70, (words, text)
        assert "internal error" not in text, (words, text)
        assert "Traceback" not in text, (words, text)


def a_loop_begins(tree: Path, state: StateDir) -> list[str]:
    """Runs it until it has nothing more to begin, and returns what it said. Raises what stops one of its passes."""
    lines: list[str] = []
    state.acquire("rorg run")
    try:
        engine = make_engine("process", state)
        loop = make_loop(tree, state, engine, lines.append)

        def enough(decision: Decision) -> bool:
            loop.wake()  # at rest, nothing may lead to another pass
            return decision.situation.observed.complete and loop.passes >= 3

        try:
            loop.run(enough)
        finally:
            for container in engine.list():
                if container.alive:
                    engine.stop(container.id, "SIGKILL", 5.0)
    finally:
        state.release()
    return lines


@pytest.mark.slow
@pytest.mark.fuzz
def test_spoilt_state_files_are_passed_over_or_told(left, tmp_path, monkeypatch):
    tree, kept = left
    monkeypatch.chdir(tmp_path)
    state = StateDir(tmp_path / "state")

    def attempt(case: Case) -> None:
        shutil.rmtree(state.path, ignore_errors=True)
        shutil.copytree(kept, state.path, ignore=shutil.ignore_patterns("run", "wakeup"))
        spoil(case, state.path)
        if case.chance.random() < 0.5:
            commands_answer(case, tree, state.path)
        with contextlib.suppress(RorgError):  # it says what is wrong
            told = a_loop_begins(tree, state)
            assert not [line for line in told if "internal error" in line or "Traceback" in line], told

    fuzz("state", 20, attempt)


@pytest.mark.parametrize("how", ODD)
def test_an_odd_requests_file_is_told_and_what_runs_goes_on(left, tmp_path, how):
    """What this robot is asked for is not known, so nothing of it is given up."""
    tree, kept = left
    state = StateDir(tmp_path / "state")
    shutil.copytree(kept, state.path, ignore=shutil.ignore_patterns("run", "wakeup", SPARE))
    ODD[how](state.requests, random.Random(1))
    code, text = said("request", "camera", "--state-dir", str(state.path))
    broken = how not in ("gone", "empty", "a link to nothing")
    assert (code, str(state.requests) in text) == ((2, True) if broken else (0, False)), text
    lines = a_loop_begins(tree, state)
    assert any(str(state.requests) in line for line in lines) == broken, lines
    assert any("suspended" in line for line in lines) == broken, lines


@pytest.mark.parametrize("how", ["binary", "a directory", "a pipe", "a link to itself", "empty"])
def test_a_robot_whose_id_cannot_be_read_is_not_taken_for_another(left, tmp_path, how):
    tree, kept = left
    state = StateDir(tmp_path / "state")
    shutil.copytree(kept, state.path, ignore=shutil.ignore_patterns("run", "wakeup"))
    ODD[how](state.path / "instance", random.Random(1))
    with pytest.raises(Invalid, match=str(state.path / "instance")):
        a_loop_begins(tree, state)
    assert state.owner() is None


def test_a_status_that_is_none_is_not_believed_though_an_rorg_runs(left, tmp_path):
    _, kept = left
    state = StateDir(tmp_path / "state")
    shutil.copytree(kept, state.path, ignore=shutil.ignore_patterns("run", "wakeup"))
    state.acquire("rorg run")
    try:
        view = {**json.loads(state.status.read_text()), "pid": os.getpid()}
        for spoilt in ({**view, "services": 5}, {**view, "services": {"camera": {}}}, {**view, "plan": None}):
            state.status.write_text(json.dumps(spoilt))
            code, text = said("get", "--state-dir", str(state.path))
            assert (code, "camera" in text) == (0, True), text
    finally:
        state.release()


@pytest.mark.slow
@pytest.mark.parametrize("name", ["run", "process", "lock", "owner.json", "instance.lock"])
def test_what_lies_in_the_place_of_another_thing_is_told_with_its_path(left, tmp_path, name):
    """Of what an rorg cannot do without."""
    tree, _ = left
    state, path = tmp_path / "state", tmp_path / "state" / name
    state.mkdir()
    path.touch() if name in ("run", "process") else path.mkdir()
    words = ["run", str(tree), "--state-dir", str(state), "--engine", "process"]
    found = commands.run(words)
    assert (found.returncode, str(path) in found.stderr) == (2, True), found.stderr


def test_an_rorg_without_its_wakeup_socket_reads_the_file_all_the_same(tmp_path):
    robot = RealRobot(tmp_path, "process", None)
    (robot.state.path / "wakeup").mkdir()
    try:
        robot.declare({"camera": {}})
        robot.settle()
        robot.request("camera")
        robot.wait(lambda: robot.active() == {"camera"})
    finally:
        robot.close()


@pytest.mark.parametrize("name", ["lock", ".requests.lock", "instance.lock"])
def test_an_odd_lock_is_told_with_its_path(tmp_path, name):
    state = StateDir(tmp_path / "state").prepare()
    (state.path / name).symlink_to(name)
    with pytest.raises(Invalid, match=name):
        state.acquire("rorg run") if name != "instance.lock" else state.instance(lambda: "id")
    state.release()
