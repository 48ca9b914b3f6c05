"""Nothing is lost, whatever is killed when."""

from __future__ import annotations

import os
import random
import subprocess
import sys
import time

import commands
import pytest
from common import wait_for
from robots import Daemon, write_tree

from rorg.store.requests_file import RequestsFile
from rorg.store.state_dir import StateDir

SERVICES = {
    "roscore": {"always_on": True},
    "localization": {"needs": ["roscore"]},
    "navigation": {"needs": ["localization"], "idle": {"action": "pause"}},
    "camera": {"idle": {"action": "pause"}},
    "speech": {"idle": {"action": "remove"}},
}


@pytest.fixture
def daemon(real_robot):
    write_tree(real_robot.tree, SERVICES)
    found = Daemon(real_robot)
    yield found
    found.kill()


@pytest.mark.slow
def test_kill_9_at_random_moments_loses_nothing(daemon):
    robot, chance = daemon.robot, random.Random(20260101)
    daemon.start()
    wait_for(daemon.settled, 60)
    roscore = robot.container("roscore").incarnation
    wanted: dict[str, tuple[str, ...]] = {}
    for round in range(20):
        id = f"r{round % 3}"
        if id in wanted and chance.random() < 0.5:
            robot.release(id)
            wanted.pop(id)
        else:
            wanted[id] = tuple(chance.sample(["navigation", "camera", "speech"], 2))
            robot.request(*wanted[id], id=id)
        # The moment is random on purpose: any point of a pass, a call or a write.
        time.sleep(chance.random() * 0.15)
        daemon.kill()
        daemon.start()
    wait_for(daemon.settled, 60)
    assert {r.id: r.services for r in robot.requests()} == wanted
    names = {n for s in wanted.values() for n in s}
    needed = {"localization"} if "navigation" in names else set()
    assert robot.active() == {"roscore"} | names | needed
    assert robot.container("roscore").incarnation == roscore, "a container that nobody touched was started again"
    assert len(robot.containers()) == len({c.service for c in robot.containers()}), "two containers of a service"


@pytest.mark.smoke
def test_a_restart_adopts_what_runs(daemon):
    robot = daemon.robot
    daemon.start()
    wait_for(daemon.settled, 60)
    robot.request("navigation", "camera")
    wait_for(lambda: daemon.settled() and "navigation" in robot.active(), 60)
    before = {c.service: c.incarnation for c in robot.containers()}
    daemon.kill()
    daemon.start()
    wait_for(daemon.settled, 60)
    assert {c.service: c.incarnation for c in robot.containers()} == before


@pytest.mark.slow
def test_requests_of_a_service_survive_a_restart_of_rorg(daemon):
    robot = daemon.robot
    daemon.start()
    wait_for(daemon.settled, 60)
    robot.request("camera", id="look", by="roscore")
    wait_for(lambda: "camera" in robot.active())
    daemon.kill()
    daemon.start()
    wait_for(daemon.settled, 60)
    assert [r.key for r in robot.requests()] == [("roscore", "look")]
    assert "camera" in robot.active()


def test_two_rorgs_never_own_one_robot(daemon):
    daemon.start()
    wait_for(daemon.settled, 60)
    robot = daemon.robot
    words = ["run", str(robot.tree), "--state-dir", str(robot.state.path), "--engine", robot.kind]
    other = commands.rorg(*words, code=5)
    assert f"pid {daemon.process.pid}" in other.stderr


@pytest.mark.smoke
def test_a_restart_of_the_engine_is_survived(docker_robot, dockerd):
    if not hasattr(dockerd, "folder"):
        pytest.skip("the engine is not ours to restart")
    robot = docker_robot
    robot.declare({"camera": {"always_on": True}, "mapper": {}})
    robot.wait(lambda: robot.active() == {"camera"})
    robot.request("mapper")
    robot.wait(lambda: robot.active() == {"camera", "mapper"})
    dockerd.stop(kill=True)
    robot.wait(lambda: not robot.loop.observer.snapshot().complete)
    assert any("engine" in line for line in robot.lines)
    robot.release()
    robot.request("mapper", id="again")
    dockerd.start()
    robot.wait(lambda: robot.active() == {"camera", "mapper"}, 60)
    robot.settle()
    assert [r.id for r in robot.requests()] == ["again"]


@pytest.mark.docker_only("it has no containerd")
def test_what_an_engine_left_that_was_killed_amid_a_start_is_made_anew(docker_robot, dockerd):
    """Docker never starts such a container again: its containerd has kept a task of it that does not run."""
    if not hasattr(dockerd, "folder"):
        pytest.skip("the engine is not ours to restart")
    robot, tasks = docker_robot, dockerd.folder / "exec/containerd/daemon/io.containerd.runtime.v2.task/moby"
    robot.declare({"camera": {}})
    robot.settle()
    for number in range(2):
        made = robot.container("camera").id
        robot.request("camera", id=f"{number}")
        wait_for((tasks / made).exists)
        dockerd.stop(kill=True)
        dockerd.start()
        robot.wait(lambda: robot.active() == {"camera"}, 60)
        robot.settle()
        assert len(robot.containers()) == 1
        robot.release(f"{number}")
        robot.settle()


@pytest.mark.docker_only("its API takes no runtime, and so none that hangs")
def test_rorg_ends_though_a_start_hangs(docker_robot, dockerd):
    if not hasattr(dockerd, "folder"):
        pytest.skip("the engine is not ours to give a runtime that hangs")
    robot, hold = docker_robot, dockerd.folder / "hold"
    write_tree(robot.tree, {"stuck": {"always_on": True, "container": {"runtime": "hang"}}})
    daemon = Daemon(robot)
    hold.touch()
    try:
        daemon.start()
        wait_for(lambda: daemon.status().get("in_flight") == {"stuck": "start"})
        daemon.process.terminate()
        assert daemon.process.wait(60) == 0
    finally:
        hold.unlink()
    daemon.start()
    wait_for(lambda: robot.active() == {"stuck"})
    assert len(robot.containers()) == 1
    daemon.kill()


def test_a_process_that_got_a_reused_pid_is_never_touched(tmp_path):
    """A record that names the pid of somebody else's process, as after a reboot or a wrap of the numbers."""
    import json

    from rorg.engines.process.engine import ProcessEngine

    stranger = subprocess.Popen(["sleep", "60"], start_new_session=True)
    try:
        engine = ProcessEngine("me", tmp_path / "process")
        container = engine.create(
            "camera", {"image": "x", "command": ["sleep", "60"]}, {"rorg.io/owner": "me", "rorg.io/service": "camera"}
        )
        engine.start(container)
        path = tmp_path / "process" / container / "record.json"
        record = json.loads(path.read_text())
        real = record["pid"]
        path.write_text(json.dumps({**record, "pid": stranger.pid}))
        assert engine.inspect(container).state == "exited"
        engine.stop(container, "SIGKILL", 1.0)
        assert stranger.poll() is None
        path.write_text(json.dumps(record))
        engine.stop(container, "SIGKILL", 1.0)
        assert not os.path.exists(f"/proc/{real}") or engine.inspect(container).state == "exited"
        engine.remove(container)
    finally:
        stranger.kill()
        stranger.wait()


def test_requests_written_at_once_are_all_kept(tmp_path):
    """Many processes change the file at the same time."""
    state = StateDir(tmp_path).prepare()
    code = (
        "import sys; from pathlib import Path; from rorg.store.requests_file import RequestsFile; "
        "from rorg.model.catalog import Request\n"
        "for i in range(10): RequestsFile(Path(sys.argv[1])).change("
        "lambda a: a.put(Request(f'{sys.argv[2]}-{i}', 'developer', ('x',))))"
    )
    running = [subprocess.Popen([sys.executable, "-c", code, str(state.requests), f"p{n}"]) for n in range(8)]
    assert [p.wait() for p in running] == [0] * 8
    file = RequestsFile(state.requests)
    file.read()
    assert len(file.document.requests) == 80
    assert not file.diagnostics
