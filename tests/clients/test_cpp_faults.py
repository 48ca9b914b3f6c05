"""The C++ client under the address, undefined and thread sanitizers: what outlives what, forks, restarts of rorg, what
is lost, and TLS."""

from __future__ import annotations

import os
from contextlib import contextmanager
from pathlib import Path
from signal import SIGKILL, SIGTERM

import commands
import pytest
from certificates import certificate
from common import free_port
from cpp_program import SANITIZERS, heard, program
from robots import RealRobot, write_tree

from rorg.client import Client

TREE = {
    "camera": {"idle": {"action": "pause"}, "ready": {"exec": ["true"], "interval": "50ms"}},
    "lidar": {},
    "arm": {"driver": {}, "conflicts": ["lidar"]},
}
BOTH = pytest.mark.parametrize("kind", SANITIZERS)


@pytest.fixture
def robot(tmp_path):
    found = RealRobot(tmp_path, "process", None, with_server=True)
    found.declare(TREE)
    found.wait(lambda: len(found.containers()) == 3)
    yield found
    found.close()


@pytest.mark.slow
@BOTH
@pytest.mark.parametrize("word", ["calls", "lifetimes", "forks", "left"])
def test_no_memory_is_misused(sanitized, robot, kind, word):
    with program(sanitized[kind], word, "0" if kind == "address" else "1", RORG_SOCKET=robot.socket()):
        pass


@pytest.mark.slow
@pytest.mark.parametrize("action", ["pause", "stop"])
def test_what_it_is_told_is_ready_stays_so_while_it_is_held(sanitized, tmp_path, action):
    robot = RealRobot(tmp_path, "process", None, with_server=True)
    robot.declare({"camera": {"idle": {"action": action, "linger": 0}}})
    try:
        with program(sanitized["thread"], "cycles", "25", RORG_SOCKET=robot.socket()):
            pass
    finally:
        robot.close()


@pytest.mark.slow
@BOTH
def test_it_is_told_what_it_lost(sanitized, robot, kind):
    with program(sanitized[kind], "losses", RORG_SOCKET=robot.socket()) as running:
        heard(running, "kill")
        robot.kill("camera")
        print("killed", file=running.stdin, flush=True)
        heard(running, "hold")
        robot.client().hold("camera", 60)
        print("held", file=running.stdin, flush=True)


# -- rorg goes away ----------------------------------------------------------------------------------------------


@contextmanager
def daemon(folder: Path, *words: str):
    """`rorg run` in a process of its own, as a function that begins it (again); ended with its services."""
    state, begun = folder / "state", []

    def begin() -> commands.Forked:
        with (folder / "log").open("a") as log:
            run = ["run", folder / "tree", "--state-dir", state, "--engine", "process", *words]
            begun.append(commands.Forked(run, stderr=log))
        return begun[-1]

    try:
        yield begin
    finally:
        from rorg.engines.make import make_engine
        from rorg.store.state_dir import StateDir

        begun[-1].terminate()
        begun[-1].wait(30)
        engine = make_engine("process", StateDir(state))
        for container in engine.list():
            engine.stop(container.id, "SIGKILL", 5.0)
            engine.remove(container.id)


@pytest.mark.slow
@BOTH
def test_a_restart_of_rorg_is_no_more_than_a_longer_wait(sanitized, tmp_path, kind):
    write_tree(tmp_path / "tree", TREE)
    with daemon(tmp_path) as begin:
        rorg = begin()
        with program(sanitized[kind], "outages", "2", RORG_SOCKET=str(tmp_path / "state/run/rorg.sock")) as running:
            for signal in (SIGKILL, SIGTERM):
                heard(running, "go")
                rorg.send_signal(signal)
                rorg.wait(30)
                rorg = begin()
                Client(str(tmp_path / "state/run/rorg.sock")).services()
                print("again", file=running.stdin, flush=True)


@pytest.mark.slow
@pytest.mark.parametrize("cause", ["replaced", "crashed"])
def test_it_is_told_what_it_lost_while_rorg_was_away(sanitized, tmp_path, cause):
    write_tree(tmp_path / "tree", TREE)
    socket = str(tmp_path / "state/run/rorg.sock")
    with daemon(tmp_path) as begin:
        rorg = begin()
        with program(sanitized["address"], "away", cause, RORG_SOCKET=socket) as running:
            heard(running, "go")
            pid = Client(socket).service("camera")["pid"]
            rorg.send_signal(SIGTERM)
            rorg.wait(30)
            if cause == "crashed":
                os.killpg(os.getpgid(pid), SIGKILL)
            else:
                changed = {**TREE["camera"], "container": {"environment": {"NEW": "1"}}}
                write_tree(tmp_path / "tree", {**TREE, "camera": changed})
            begin()
            print("again", file=running.stdin, flush=True)


@pytest.mark.slow
@BOTH
def test_over_tls(sanitized, tmp_path, kind):
    for name, authority in (("authority", ""), ("robot", "authority"), ("ada", "authority")):
        certificate(tmp_path, name, authority)
    write_tree(tmp_path / "tree", {"camera": {}})
    port = free_port()
    words = ["--listen", f"127.0.0.1:{port}"]
    for word, name in (("--tls-cert", "robot.pem"), ("--tls-key", "robot.key"), ("--tls-ca", "authority.pem")):
        words += [word, str(tmp_path / name)]
    names = {
        f"RORG_{word}": str(tmp_path / name)
        for word, name in (("CA", "authority.pem"), ("CERT", "ada.pem"), ("KEY", "ada.key"))
    }
    with daemon(tmp_path, *words) as begin:
        begin()
        with program(sanitized[kind], "secured", RORG_ADDRESS=f"https://127.0.0.1:{port}", **names):
            pass
