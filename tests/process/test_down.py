"""`rorg down`: nothing of a robot is left but its manifests, with a running rorg and without, whatever is killed."""

from __future__ import annotations

import json
import os
import subprocess
from dataclasses import replace

import commands
import psutil
import pytest
from common import wait_for
from robots import WORK, VirtualRobot, write_tree
from rorg_client import Client, Forbidden
from rorg_process import RorgProcess

from rorg.core.observed import Container
from rorg.daemon.teardown import is_down
from rorg.errors import RorgError
from rorg.store.clear import clear, stays_down
from rorg.store.requests_document import RequestsDocument
from rorg.store.requests_file import RequestsFile
from rorg.store.state_dir import StateDir

SERVICES = {
    "base": {"always_on": True, "driver": {}},
    "map": {"needs": ["base"]},
    "navigation": {"needs": ["map"], "idle": {"action": "pause"}},
    "behavior": {"always_on": True, "may_request": ["map"]},
}


@pytest.fixture
def robot(tmp_path):
    """With one service paused, and a request."""
    found = RorgProcess(tmp_path, SERVICES).start()
    client = found.client(patience=10.0)
    wait_for(lambda: (found.state / "run/rorg.sock").exists())
    client.request("navigation", id="go", wait=30)
    client.release("go")
    wait_for(lambda: client.service("navigation")["state"] == "paused")
    client.request("map", id="look", wait=30)
    yield found
    found.close()


def rorg(robot: RorgProcess, *words: str, code: int = 0) -> subprocess.CompletedProcess[str]:
    """From a directory that is no robot's: of this one no more is named than its state."""
    return commands.rorg(*words, code=code, cwd=robot.folder, RORG_STATE_DIR=str(robot.state), RORG_ENGINE="process")


def pids(robot: RorgProcess) -> set[int]:
    """Of the robot's programs."""
    return {s["pid"] for s in robot.client().services() if s["pid"]}


def nothing_is_left(robot: RorgProcess, programs: set[int], history: bool = True) -> bool:
    """But whose robot it is, that it is down, and its history."""
    left = {p.name for p in robot.state.iterdir()} - ({"journal.db-wal", "journal.db-shm"} if history else set())
    stays = {"instance", "requests.yaml"} | ({"journal.db"} if history else set())
    return left == stays and not any(map(runs, programs))


def runs(pid: int) -> bool:
    """What has ended may be there until whoever took it over asks for its end."""
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


@pytest.mark.slow
@pytest.mark.parametrize("end", ["serving", "stopped", "killed"])
def test_nothing_is_left_but_the_manifests(robot, end):
    programs = pids(robot)
    assert len(programs) == 4, "the paused one too"
    if end != "serving":
        robot.stop(kill=end == "killed")
    manifests = {p: p.read_bytes() for p in robot.tree.rglob("*.yaml")}
    done = rorg(robot, "down", "--yes")
    assert "base" in done.stderr
    assert "driver" in done.stderr
    assert robot.process.wait(30) == (-9 if end == "killed" else 0)
    assert nothing_is_left(robot, programs)
    assert {p: p.read_bytes() for p in robot.tree.rglob("*.yaml")} == manifests
    services = json.loads(rorg(robot, "get", "--manifests", str(robot.tree), "-o", "json").stdout)
    base = next(s for s in services if s["service"] == "base")
    assert (base["health"], base["message"]) == ("Waiting", "the robot is down")


@pytest.mark.slow
def test_it_is_known_to_the_state_alone(robot):
    programs = pids(robot)
    robot.stop()
    for path in robot.tree.rglob("*.yaml"):
        path.unlink()
    rorg(robot, "down", "--yes")
    assert nothing_is_left(robot, programs)


@pytest.mark.slow
def test_without_a_terminal_nothing_is_done_unless_it_was_said(robot):
    done = rorg(robot, "down", code=5)
    assert "--yes" in done.stderr
    assert robot.client().service("base")["state"] == "running"
    robot.client().call("PUT", "/v1/suspension", {"duration": "1m"})
    done = rorg(robot, "down", "--yes", code=5)
    assert "suspend" in done.stderr
    assert robot.client().service("base")["state"] == "running"


@pytest.mark.slow
def test_requests_can_be_kept(robot):
    programs = pids(robot)
    rorg(robot, "down", "--yes", "--keep-requests")
    assert not any(map(runs, programs))
    assert nothing_is_left(robot, programs)
    robot.start()
    wait_for(lambda: (robot.state / "run/rorg.sock").exists())
    robot.client(patience=10.0).wait("map", timeout=30)


@pytest.mark.slow
@pytest.mark.parametrize("end", ["serving", "killed"])
def test_the_history_outlives_it_unless_it_is_to_be_forgotten(robot, end):
    """The robot that comes up again is the same one."""
    wait_for(lambda: "good" in rorg(robot, "history").stdout)
    if end == "killed":
        robot.stop(kill=True)
    done = rorg(robot, "down", "--yes")
    assert "the history stays" in done.stderr
    assert "good" in rorg(robot, "history").stdout
    assert "the robot is taken down" in rorg(robot, "events", "--tail", "200").stdout or end == "killed"
    robot.start()
    wait_for(lambda: (robot.state / "run/rorg.sock").exists())
    robot.client(patience=10.0).wait("behavior", timeout=30)
    said = rorg(robot, "events", "--tail", "500").stdout
    assert "requested by developer (go)" in said, "from before"
    programs = pids(robot)
    if end == "killed":
        robot.stop(kill=True)
    done = rorg(robot, "down", "--yes", "--forget")
    assert "the history is removed: all events and 1 revision of the manifests" in done.stderr
    wait_for(lambda: nothing_is_left(robot, programs, history=False))


@pytest.mark.slow
def test_what_failed_before_it_was_taken_down_is_not_good_afterwards(robot):
    wait_for(lambda: "good" in rorg(robot, "history").stdout)
    bad = {**SERVICES, "behavior": {"always_on": True, "command": ["sh", "-c", "exit 7"]}}
    write_tree(robot.tree, bad)
    wait_for(lambda: "failed" in rorg(robot, "history").stdout)
    rorg(robot, "down", "--yes")
    robot.start()
    wait_for(lambda: (robot.state / "run/rorg.sock").exists())
    robot.client(patience=10.0).wait("base", timeout=30)
    assert rorg(robot, "history").stdout.count("good") == 1
    assert "failed" in rorg(robot, "history").stdout


@pytest.mark.slow
def test_what_is_begun_is_ended_by_the_next_rorg(tmp_path):
    """Killed once it is accepted, while a program takes its time to end."""
    slow = {"command": [*WORK[:3], f"{WORK[3]}\nimport time\ntime.sleep(3)"], "always_on": True}
    robot = RorgProcess(tmp_path, {"base": slow, "map": {"always_on": True}}).start()
    try:
        client = robot.client(patience=10.0)
        wait_for(lambda: (robot.state / "run/rorg.sock").exists())
        client.wait("base", "map", timeout=30)
        programs = pids(robot)
        client.call("PUT", "/v1/down", {})
        robot.stop(kill=True)
        assert (robot.state / "requests.yaml").exists()
        robot.start()
        assert robot.process.wait(30) == 0
        assert nothing_is_left(robot, programs)
    finally:
        robot.close()


@pytest.mark.slow
def test_whoever_restarts_rorg_leaves_it_down(robot):
    """systemd, say, at the next boot; a person says `run` or `up`, with a running rorg and without."""
    programs, identity = pids(robot), (robot.state / "instance").read_text()
    rorg(robot, "down", "--yes")
    assert nothing_is_left(robot, programs)
    assert (robot.state / "instance").read_text() == identity, "volumes carry it"
    for _ in range(2):
        restarted(robot)
        view = robot.client(patience=60.0).status()
        assert (view["down"], pids(robot)) == ("down", set())
        assert "rorg up" in rorg(robot, "get").stderr
        assert "rorg up" in rorg(robot, "request", "map", code=5).stderr
        assert "rorg up" in rorg(robot, "apply", str(robot.tree), "--yes", code=5).stderr
        robot.stop()
        assert robot.process.returncode == 0
    restarted(robot)
    words = {"RORG_STATE_DIR": str(robot.state), "RORG_STAY_DOWN": "1"}  # as within rorg's container
    assert f"pid {robot.process.pid}" in commands.rorg("up", cwd=robot.folder, **words).stderr
    robot.client(patience=60.0).wait("base", timeout=60)
    rorg(robot, "down", "--yes")
    assert robot.process.wait(30) == 0, "it can be taken down again"
    robot.start()
    robot.client(patience=60.0).wait("base", timeout=60)


def restarted(robot: RorgProcess) -> None:
    """Its rorg runs again, until it has looked at the robot, though no person has said so."""
    robot.start(env={**os.environ, "RORG_STAY_DOWN": "1"})
    wait_for(lambda: (robot.state / "run/rorg.sock").exists())
    wait_for(lambda: robot.client(patience=60.0).status()["services"])


@pytest.mark.slow
def test_apply_brings_up_what_is_down(robot):
    rorg(robot, "down", "--yes")
    rorg(robot, "apply", str(robot.tree), "--yes", "--wait")
    robot.start(env={**os.environ, "RORG_STAY_DOWN": "1"})
    robot.client(patience=60.0).wait("base", timeout=60)


def test_a_container_that_names_no_service_keeps_nothing_up(tmp_path):
    """It is left alone, so the robot is down without it."""
    virtual = VirtualRobot(tmp_path)
    virtual.declare({"people": {"type": "meta"}})
    left_alone = Container("stray", "stray", "", "running")
    virtual.sim.engine.containers["stray"] = left_alone
    virtual.settle()
    decision = virtual.sim.decision
    assert decision.situation.observed.containers == (left_alone,)
    assert is_down(RequestsDocument(down=True), decision)


@pytest.mark.slow
def test_a_service_may_not(robot):
    service = Client(robot.socket("behavior"))
    with pytest.raises(Forbidden):
        service.call("PUT", "/v1/down", {})
    assert robot.client().service("base")["state"] == "running"


def test_that_it_is_down_is_noted_last(tmp_path):
    """An rorg that ends before the note finds the robot going down, and clears again."""
    state = StateDir(tmp_path / "state").prepare()
    file = RequestsFile(state.requests)
    file.change(lambda asked: replace(asked, down=True))
    (state.path / "status.json").write_text("{}")
    text = state.requests.read_text()
    state.requests.unlink()
    state.requests.mkdir()  # the note is refused
    with pytest.raises(RorgError):
        clear(state, 0.0)
    assert not (state.path / "status.json").exists()
    state.requests.rmdir()
    state.requests.write_text(text)
    clear(state, 0.0)
    assert stays_down(state, restarted=True).startswith("1970-01-01T00:00:00")
