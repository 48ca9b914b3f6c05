"""`rorg demo` tells a story: what it prints is what the engine says, and it leaves nothing behind, also when it is
interrupted."""

from __future__ import annotations

import io
import os
import re
import signal
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from common import alone_on_the_machine, wait_for
from left_behind import left_behind
from rich.console import Console

from rorg.cli.demo import accidents, updates
from rorg.cli.demo.live import LiveTable
from rorg.cli.demo.robot import ACTIONS, DemoRobot
from rorg.cli.demo.show import Show
from rorg.cli.demo.snapshot import Change, Service, Snapshot
from rorg.cli.demo.stage import Stage
from rorg.cli.demo.story import SCENES, prepare

MOST_LINES, MOST_COLUMNS = 70, 80
COUNTS = re.compile(r"  (\d+) services run, (\d+) paused, (\d+) stopped")
CHANGE = re.compile(r"  (started|resumed|paused|stopped) +(\w+) ")
LEFT_IN = {"started": "running", "resumed": "running", "paused": "paused", "stopped": "stopped"}
Runs = dict[str, tuple[str, str]]
"""Service -> its container that runs, and the start of that run."""


@pytest.fixture(autouse=True)
def ports() -> Iterator[None]:
    """Its services answer at ports of the machine: another one's that are paused would be taken for ours."""
    with alone_on_the_machine("demo"):
        yield


# -- each scene, against the engine ------------------------------------------------------------------------------


def states(robot: DemoRobot) -> dict[str, str]:
    """What the engine says of each service."""
    return {c.service: c.state if c.state in ("running", "paused") else "stopped" for c in robot.engine.list()}


def runs(robot: DemoRobot) -> Runs:
    return {c.service: (c.id, c.started_at) for c in robot.engine.list() if c.state == "running"}


def check_words(robot: DemoRobot, text: str) -> None:
    """The last counts of a scene, and the services that it names."""
    present = states(robot)
    count = Counter(present.values())
    if printed := COUNTS.findall(text):
        assert [int(n) for n in printed[-1]] == [count["running"], count["paused"], count["stopped"]]
    for verb, service in CHANGE.findall(text):
        assert present[service] == LEFT_IN[verb], text


def check_crash(before: Runs, after: Runs, text: str) -> None:
    """Navigation runs again, nothing else began anew, and the next rorg restarted nothing."""
    assert {n for n in after if after[n] != before[n]} == {accidents.VICTIM}
    assert after[accidents.VICTIM][0] == before[accidents.VICTIM][0], "the same container"
    assert f"{len(before) - 1} others ran on" in text


def check_kill(before: Runs, after: Runs, text: str) -> None:
    assert after == before
    assert f"{len(before)} services run on without rorg" in text
    assert text.rstrip().endswith(f"{len(before)} services ran on")


def check_mistake(before: Runs, after: Runs, text: str) -> None:
    assert after == before
    assert "  manifests/services/ros_trigger_ui.yaml:8:3: unknown key 'imagge'; try 'image'" in text
    assert f"the commit was refused; {len(before)} services ran on" in text


def check_update(before: Runs, after: Runs, text: str) -> None:
    """The container of before the update runs again."""
    assert {n for n in after if after[n] != before[n]} == {updates.UPDATED}
    assert after[updates.UPDATED][0] == before[updates.UPDATED][0]
    assert re.search(r"undone after [\d.]+ s, because it ended with exit code 1; ", text)
    assert f"{len(before)} services ran on" in text.splitlines()[-1]


CHECKS = {
    accidents.crash: check_crash,
    accidents.kill_rorg: check_kill,
    updates.typing_mistake: check_mistake,
    updates.bad_update: check_update,
}


def play_scenes(engine: str) -> str:
    """Plays all scenes, each checked at its end. Returns what they printed."""
    paper = io.StringIO()
    show = Show(20.0, False, console=Console(file=paper, width=MOST_COLUMNS))
    robot = DemoRobot(engine)
    try:
        prepare(robot, show)
        stage = Stage(robot, show)
        for scene in SCENES:
            before, printed = runs(robot), len(paper.getvalue())
            scene(stage)
            text = paper.getvalue()[printed:]
            check_words(robot, text)
            if scene in CHECKS:
                CHECKS[scene](before, runs(robot), text)
        check_work(stage)
    finally:
        robot.clean_up(print)
    assert not robot.folder.exists()
    return paper.getvalue()


def check_work(stage: Stage) -> None:
    """What the robot requested in each action ran in it, and on the tour what only navigation needs."""
    standby, tour = stage.moments.values()
    assert set(ACTIONS["standby"]) <= standby.names("running")
    assert {*ACTIONS["tour"], "navigation", "cartographer_localization"} <= tour.names("running")
    assert not {*ACTIONS["standby"]} & tour.names("running")
    assert "cartographer_localization" not in standby.names("running")
    assert len(stage.uses) == 6
    assert all(use.cpu > 0 and use.memory > 0 for use in stage.uses)


@pytest.mark.slow
def test_scenes_on_processes(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    text = play_scenes("process")
    assert text.count("ignores") == 1
    assert left_behind(tmp_path, "rorg-demo-") == []


@pytest.mark.docker
def test_scenes_on_docker(dockerd, monkeypatch):
    import docker

    monkeypatch.setenv("DOCKER_HOST", dockerd.host)
    text = play_scenes("docker")
    assert re.search(r"images built in \d+ s", text)
    api = docker.APIClient(dockerd.host, version="auto")
    assert [c for c in api.containers(all=True) if "rorg-demo" in c["Names"][0]] == []


# -- the whole command -------------------------------------------------------------------------------------------


def demo(folder: Path, *args: str, **env: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "rorg", "demo", "--speed", "20", *args],
        text=True,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        env={**os.environ, "TMPDIR": str(folder), **env},
    )


def check_story(output: str) -> None:
    lines = output.splitlines()
    assert len(lines) <= MOST_LINES
    assert max(map(len, lines)) <= MOST_COLUMNS
    commands = [line for line in lines if line.startswith("$ ")]
    for begin in ("rorg run", "rorg request tour", "kill -9", "git commit", "git revert"):
        assert any(line.startswith(f"$ {begin}") for line in commands), begin
    assert re.search(r"CPU +everything on +[\d.]+ cores  █{40}\n +on demand +[\d.]+ cores  █* [+-]\d+%", output)


def rorg(state: str, *words: str) -> str:
    command = [sys.executable, "-m", "rorg", *words]
    return subprocess.run(
        command, env={**os.environ, "RORG_STATE_DIR": state}, text=True, capture_output=True, check=True, timeout=120
    ).stdout


@pytest.mark.slow
def test_demo_keeps_a_robot_of_processes(tmp_path):
    """The commands that it names at the end work, and the last one leaves nothing."""
    process = demo(tmp_path, "--engine", "process", "--keep")
    output, _ = process.communicate(timeout=300)
    assert process.returncode == 0, output
    state = re.search(r"export RORG_STATE_DIR=(\S+)", output)[1]
    try:
        check_story(output.replace(str(tmp_path), "/tmp"))
        assert re.search(r"^navigation +running +Synced +Healthy ", rorg(state, "get"), re.MULTILINE)
        assert "navigation_route (requested by behavioral (action))" in rorg(state, "why", "navigation")
    finally:
        rorg(state, "down", "--yes")
    subprocess.run(["rm", "-r", re.search(r"rorg down --yes && rm -r (\S+)", output)[1]], check=True)
    wait_for(lambda: left_behind(tmp_path, "rorg-demo-") == [], 30, "the end of its rorg")


@pytest.mark.docker
def test_demo_on_docker(tmp_path, dockerd):
    """With a picture, and all that rorg does."""
    picture = tmp_path / "tour.svg"
    process = demo(tmp_path, "--verbose", "--svg", str(picture), DOCKER_HOST=dockerd.host)
    output, _ = process.communicate(timeout=300)
    assert process.returncode == 0, output
    assert "on the docker engine" in output.splitlines()[0]
    actions = [line for line in output.splitlines() if line.startswith("| ")]
    assert any("> start cartographer_localization (needed by " in line for line in actions)
    assert any("# stop cartographer_localization (not wanted)" in line for line in actions)
    check_story("".join(line for line in output.splitlines(keepends=True) if not line.startswith("| ")))
    assert picture.read_text().count(">navigation<") == 2
    assert left_behind(tmp_path, "rorg-demo-") == []


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_demo_interrupted(tmp_path, number):
    process = demo(tmp_path, "--engine", "process")
    wait_for(lambda: len(left_behind(tmp_path, "rorg-demo-")) > 8, 60, "a dozen of services")
    process.send_signal(number)
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 130, output
    assert left_behind(tmp_path, "rorg-demo-") == []


@pytest.mark.slow
def test_demo_without_git(tmp_path):
    process = demo(tmp_path, "--engine", "process", PATH="/nowhere")
    output, _ = process.communicate(timeout=60)
    assert process.returncode == 2, output
    assert (
        output.splitlines()[-1]
        == "rorg: cannot run the demo: git is not installed here; install git, or add it to PATH"
    )
    assert left_behind(tmp_path, "rorg-demo-") == []


# -- what it is made of ------------------------------------------------------------------------------------------


def test_the_live_table_changes_in_place_and_is_erased():
    paper = io.StringIO()
    console = Console(file=paper, force_terminal=True, width=80, height=40, _environ={"TERM": "xterm"})
    moment = Snapshot({"arm": Service("running", "", "1"), "lidar": Service("paused", "", "2")})
    table = LiveTable(console, lambda: moment)
    table.start()
    assert "● arm" in paper.getvalue()
    assert "‖ lidar" in paper.getvalue()
    assert "1 services run, 1 paused, 0 stopped" in paper.getvalue()
    table.stop()
    assert paper.getvalue().rstrip().endswith("\x1b[2K"), "the last thing it does is to erase its lines"


def test_prose_is_broken_and_what_one_copies_is_not():
    paper = io.StringIO()
    show = Show(1.0, False, console=Console(file=paper, width=200))
    show.title(f"rorg demo: a tour guide ({'its socket is missing, ' * 6}so that is that)")
    show.line(f"{'many words ' * 6}and then `rorg why navigation_route` and more")
    command = f"rorg down --yes && rm -r /tmp/{'x' * 80}"
    show.command(command)
    show.copied(command)
    lines = paper.getvalue().splitlines()
    assert [line for line in lines if len(line) > MOST_COLUMNS] == [f"$ {command}", f"  {command}"]
    assert any(line.startswith("    `rorg why navigation_route` and more") for line in lines), lines
    assert all(line.startswith("  ") for line in lines[1:] if not line.startswith("$ "))


def test_a_snapshot_names_what_changed():
    before = Snapshot(
        {"a": Service("running", "", "1"), "b": Service("paused", "", "2"), "d": Service("running", "", "4")}
    )
    now = Snapshot(
        {
            "a": Service("paused", "", "1"),
            "b": Service("running", "needed by c", "2"),
            "c": Service("running", "requested", "3"),
            "d": Service("running", "", "5"),
        }
    )
    assert list(now.changes(before)) == [
        Change("paused", "a", ""),
        Change("resumed", "b", "needed by c"),
        Change("started", "c", "requested"),
    ]
    assert now.counts() == "3 services run, 1 paused, 0 stopped"
    assert now.runs() == {"b": "2", "c": "3", "d": "5"}
