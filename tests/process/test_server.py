"""What a caller can do wrong, on purpose or by dying, and nobody else notices."""

from __future__ import annotations

import asyncio
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import commands
import pytest
from common import wait_for
from robots import RealRobot, write_tree
from tools import tool

import rorg.api.limits
import rorg.host.git
from rorg.client import AsyncClient, Client, Error, Invalid, Refused, Unreachable
from rorg.errors import Busy

TREE = {"alpha": {"may_request": ["camera"]}, "beta": {"may_request": ["camera"]}, "camera": {}, "lidar": {}}


@pytest.fixture
def robot(tmp_path):
    found = RealRobot(tmp_path, "process", None, with_server=True)
    found.declare(TREE)
    found.wait(lambda: len(found.containers()) == 4)
    yield found
    found.close()


def connect(robot, service: str = "") -> socket.socket:
    found = socket.socket(socket.AF_UNIX)
    found.connect(robot.socket(service))
    return found


def hung_up(connection: socket.socket) -> bool:
    connection.setblocking(False)
    try:
        return connection.recv(1) == b""
    except BlockingIOError:
        return False
    except ConnectionError:
        return True


# -- sockets of services ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_link_in_the_place_of_a_socket_is_replaced_and_not_followed(robot, tmp_path):
    """A program in a container could put one there, if its mount let it."""
    secret = tmp_path / "secret"
    secret.write_text("x")
    secret.chmod(0o600)
    place = robot.state.run / "services/alpha/rorg.sock"
    robot.stop()
    place.unlink()
    place.symlink_to(secret)
    robot.start()
    wait_for(lambda: not place.is_symlink())
    assert secret.stat().st_mode & 0o777 == 0o600
    assert place.stat().st_mode & 0o777 == 0o666
    robot.client("alpha", patience=5).services()


@pytest.mark.slow
def test_a_service_that_spoils_its_directory_has_no_socket_and_the_others_have(robot, monkeypatch):
    monkeypatch.setattr("rorg.api.sockets.RETRY", 0.1)
    place = robot.state.run / "services/alpha/rorg.sock"
    robot.stop()
    place.unlink()
    place.mkdir()
    robot.start()
    wait_for(lambda: robot.client("beta", patience=5).services())
    robot.wait(lambda: any("alpha has no socket" in line for line in robot.lines))
    place.rmdir()
    robot.wait(lambda: (robot.loop.wake(), place.is_socket())[1])
    robot.client("alpha", patience=5).services()


@pytest.mark.slow
def test_sockets_that_somebody_removed_come_back(robot, monkeypatch):
    monkeypatch.setattr("rorg.api.server.RESTORE", 0.1)
    robot.stop()
    robot.start()
    robot.client("alpha", patience=5).services()
    before, after = robot.client(), robot.client(patience=0)
    before.services()
    for remove in (lambda: shutil.rmtree(robot.state.run), lambda: Path(robot.socket("alpha")).unlink()):
        mounted = os.open(Path(robot.socket("alpha")).parent, os.O_PATH)
        remove()
        before.services()
        for service in ("", "alpha", "beta"):
            wait_for(lambda service=service: os.path.exists(robot.socket(service)), 30, f"the socket of {service}")
            robot.client(service, patience=5).services()
    assert os.path.exists(f"/proc/self/fd/{mounted}/rorg.sock"), "what a container mounts stays"
    os.close(mounted)
    after.services()
    assert [line for line in robot.lines if "had been removed, and was made again" in line]


@pytest.mark.slow
def test_a_service_cannot_take_the_room_of_others(robot):
    """It may have so many connections; waits that nobody waits for any more end."""
    monkey = [connect(robot, "alpha") for _ in range(rorg.api.limits.MOST_OF_ONE)]
    wait_for(lambda: robot.server.accounts.of_service("alpha").connections == len(monkey))
    robot.client("beta").services()
    for connection in monkey:
        connection.sendall(b"GET /v1/wait?services=camera&timeout=3600 HTTP/1.1\r\nhost: x\r\n\r\n")
    wait_for(lambda: len(robot.server.uvicorn.server_state.tasks) >= len(monkey))
    wait_for(lambda: hung_up(connect(robot, "alpha")), what="one more is refused")
    for connection in monkey:
        connection.close()
    wait_for(lambda: not robot.server.uvicorn.server_state.tasks)
    wait_for(lambda: robot.server.accounts.of_service("alpha").connections == 0)
    robot.client("alpha").services()


@pytest.mark.slow
@pytest.mark.parametrize("service", ["", "alpha"])
def test_a_caller_with_idle_connections_gets_a_new_one(robot, service, monkeypatch):
    """In place of the one that has asked nothing for longest: those that are answered stay."""
    monkeypatch.setattr(robot.server, "room", 100)
    waiting = connect(robot, service)
    waiting.sendall(b"GET /v1/events?follow=true HTTP/1.1\r\nhost: x\r\n\r\n")
    wait_for(lambda: len(robot.server.uvicorn.server_state.tasks) == 1)
    idle = [connect(robot, service) for _ in range(200)]
    wait_for(lambda: sum(hung_up(connection) for connection in idle) >= 150, what="all of the burst to be taken")
    client = robot.client(service, patience=0.0)
    client.services()
    wait_for(lambda: len(robot.server.uvicorn.server_state.tasks) == 1)
    wait_for(lambda: hung_up(idle[0]), what="the oldest one to be closed")
    for connection in (waiting, *idle):
        connection.close()


def test_who_follows_events_and_hangs_up_is_forgotten(robot):
    connection = connect(robot)
    connection.sendall(b"GET /v1/events?follow=true HTTP/1.1\r\nhost: x\r\n\r\n")
    wait_for(lambda: len(robot.server.uvicorn.server_state.tasks) == 1)
    connection.close()
    wait_for(lambda: not robot.server.uvicorn.server_state.tasks)


@pytest.mark.slow
@pytest.mark.parametrize(
    "said",
    [
        b"",
        b"GET /v1/services HTTP/1.1\r\nhost: x",
        b"GET /v1/services HTTP/1.1\r\nhost: x\r\n\r\n",
        b"PUT /v1/requests/x HTTP/1.1\r\nhost: x\r\ncontent-length: 99\r\n\r\n{",
    ],
)
def test_who_asks_nothing_or_half_of_something_is_hung_up_on(robot, monkeypatch, said):
    monkeypatch.setattr(rorg.api.limits, "IDLE", 0.3)
    monkeypatch.setattr(rorg.api.limits, "COMPLETE", 0.3)
    connection = connect(robot)
    connection.sendall(said)
    connection.settimeout(10)
    while connection.recv(1 << 20):
        pass


@pytest.mark.slow
def test_who_waits_for_an_answer_is_not(robot, monkeypatch):
    monkeypatch.setattr(rorg.api.limits, "IDLE", 0.2)
    began = time.monotonic()
    with pytest.raises(Error, match="camera"):
        robot.client().wait("camera", timeout=1.5)
    assert time.monotonic() - began > 1.4


# -- errors ----------------------------------------------------------------------------------------------------


def test_a_change_that_cannot_be_written_spoils_no_other(robot):
    client = robot.client()
    with pytest.raises(Invalid, match="more than"):
        client.hold("camera", 1e12)
    committer = robot.server.operations.committer

    def spoil(asked):
        return type(asked)(requests=("no request",))

    futures = [committer.submit(edit) for edit in (spoil, lambda asked: asked, spoil)]
    assert [type(f.exception(10)).__name__ for f in futures] == ["AttributeError", "NoneType", "AttributeError"]


def test_a_full_disk_is_told_as_what_it_is(robot, monkeypatch):
    def full(*args, **more):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("rorg.store.requests_file.write_atomic", full)
    with pytest.raises(Unreachable, match="No space left on device"):
        robot.client(patience=0.2).request("camera", id="x", ttl=None)


def test_why_of_a_meta_service_is_answered(robot):
    assert robot.client().why("developer")[0]["wanted"] is True


def test_who_does_not_listen_to_us_ends_nothing(robot, monkeypatch):
    def gone(line: str) -> None:
        raise BrokenPipeError

    monkeypatch.setattr(robot.loop.recorder, "say", gone)
    with robot.client().request("camera", wait=20):
        assert "camera" in robot.active()
    robot.wait(lambda: robot.active() == set())


@pytest.mark.slow
def test_a_port_that_is_taken_is_told_at_once(tmp_path):
    root = write_tree(tmp_path / "tree", TREE)
    names = {k: tmp_path / k for k in ("key", "cert")}
    subprocess.run(
        [
            tool("openssl"),
            "req",
            "-x509",
            "-newkey",
            "rsa:2048",
            "-nodes",
            "-keyout",
            names["key"],
            "-out",
            names["cert"],
            "-days",
            "9",
            "-subj",
            "/CN=x",
        ],
        capture_output=True,
        check=True,
    )
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        words = ["run", root, "--engine", "process", "--state-dir", tmp_path / "state", "--listen", f"127.0.0.1:{port}"]
        files = ["--tls-cert", names["cert"], "--tls-key", names["key"], "--tls-ca", names["cert"]]
        done = commands.run([*words, *files])
    assert done.returncode == 2
    assert "Address already in use" in done.stderr


# -- manifests -------------------------------------------------------------------------------------------------


def git(robot, *args: str) -> str:
    return subprocess.run(
        ["git", "-c", "user.name=t", "-c", "user.email=t@x", *args],
        cwd=robot.tree,
        check=True,
        capture_output=True,
        text=True,
    ).stdout


@pytest.fixture
def repository(robot):
    for args in (["init", "-q"], ["add", "-A"], ["commit", "-qm", "all"]):
        git(robot, *args)
    robot.stop()
    robot.start()
    return robot


def base(client: Client, name: str) -> str:
    return next(m["digest"] for m in client.manifests() if m["name"] == name)


@pytest.mark.slow
def test_a_commit_that_takes_too_long_leaves_no_lock_behind(repository, monkeypatch):
    monkeypatch.setattr(rorg.host.git, "COMMIT_PATIENCE", 0.5)
    hook = repository.tree / ".git/hooks/pre-commit"
    hook.write_text("#!/bin/sh\nexec sleep 20\n")
    hook.chmod(0o755)
    client = repository.client(timeout=30)
    text = client.manifest("Service", "lidar") + "  priority: 70\n"
    client.put_manifest("Service", "lidar", text, base(client, "lidar"))
    wait_for(lambda: not list((repository.tree / ".git").glob("*.lock")))
    wait_for(lambda: client.service("lidar")["effective_priority"] == 70)


@pytest.mark.slow
def test_a_lock_that_a_killed_git_left_behind_does_not_hide_the_tree_for_ever(repository):
    lock = repository.tree / ".git/index.lock"
    lock.touch()
    os.utime(lock, (time.time() - 3600,) * 2)
    write_tree(repository.tree, {**TREE, "lidar": {"priority": 71}})
    wait_for(lambda: repository.client().service("lidar")["effective_priority"] == 71)


def test_a_manifest_is_not_written_over_another_one(robot):
    client = robot.client()
    path = robot.tree / "services/sensor.yaml"
    text = (robot.tree / "services/lidar.yaml").read_text()
    path.write_text(text.replace("name: lidar", "name: radar"))
    with pytest.raises(Refused, match=r"services/sensor.yaml declares something else"):
        client.put_manifest("Service", "sensor", text.replace("name: lidar", "name: sensor"), None)
    assert "name: radar" in path.read_text()


def test_digests_are_of_bytes(robot):
    client = robot.client()
    text = client.manifest("Service", "lidar").replace("\n", "\r\n")
    told = client.put_manifest("Service", "lidar", text, base(client, "lidar"))
    assert told["digest"] == base(client, "lidar")
    client.put_manifest("Service", "lidar", text + "  priority: 70\r\n", told["digest"])
    path = robot.tree / "services/camera.yaml"
    path.write_bytes("# é\n".encode("latin-1") + path.read_bytes())
    assert len(client.manifests()) == 4
    assert "name: camera" in client.manifest("Service", "camera")


@pytest.mark.slow
def test_a_text_that_is_nested_without_end_is_refused(robot):
    with pytest.raises(Invalid, match="nested more than"):
        robot.client().put_manifest("Service", "lidar", "[" * 40000, base(robot.client(), "lidar"))


# -- clients ---------------------------------------------------------------------------------------------------


def test_a_cancelled_request_is_released(robot):
    robot.declare({**TREE, "camera": {"ready": {"delay": "2s"}}})
    wait_for(lambda: robot.loop.tree.desired.catalog.services["camera"].ready)

    async def impatient() -> None:
        client = AsyncClient(robot.socket())
        with pytest.raises(TimeoutError):
            async with asyncio.timeout(0.3), client.request("camera", wait=20, ttl=None):
                raise AssertionError("it cannot be ready yet")

    asyncio.run(impatient())
    wait_for(lambda: not robot.client().requests())


@pytest.mark.slow
def test_a_release_that_failed_can_be_repeated(robot):
    client = robot.client(patience=0.2)
    request = client.request("camera", ttl=None)
    robot.stop()
    with pytest.raises(Unreachable):
        request.release()
    robot.start()
    wait_for(lambda: robot.client(patience=5).requests())
    request.release()
    wait_for(lambda: not robot.client().requests())


def test_a_connection_that_was_closed_meanwhile_is_no_failure(robot):
    client = robot.client(patience=0.0)
    client.services()
    robot.stop()
    robot.start()
    wait_for(lambda: connect(robot) is not None)
    robot.client(patience=10).services()
    client.services()


@pytest.mark.slow
def test_a_beat_that_is_not_answered_delays_no_release(robot):
    with socket.socket(socket.AF_UNIX) as deaf:
        request = robot.client(timeout=0.5, patience=0.5).request("camera", ttl=3.0)
        robot.stop()
        (robot.state.run / "rorg.sock").unlink(missing_ok=True)
        deaf.bind(robot.socket())
        deaf.listen()
        deaf.settimeout(10)
        deaf.accept()
        began = time.monotonic()
        with pytest.raises(Unreachable):
            request.release()
        assert time.monotonic() - began < 5
        os.unlink(robot.socket())
    robot.start()


@pytest.mark.slow
def test_a_follower_misses_nothing_over_a_restart_though_it_has_seen_nothing_yet(robot):
    robot.settle()
    seen: list[dict] = []
    follower = robot.client()
    threading.Thread(target=lambda: [seen.append(e) for e in follower.events(follow=True)], daemon=True).start()
    wait_for(lambda: robot.loop.recorder.journal._followers)
    at = robot.loop.recorder.journal.last
    robot.stop()
    robot.start()
    with robot.client(patience=10).request("camera", wait=20):
        last = robot.loop.recorder.journal.last
        wait_for(lambda: [e["seq"] for e in seen][: last - at] == list(range(at + 1, last + 1)))


@pytest.mark.slow
def test_a_child_does_not_read_its_parents_answers(robot):
    code = f"""
import os
from rorg.client import Client
client = Client({robot.socket()!r})
client.service("camera")
child = os.fork()
name = "camera" if child else "lidar"
wrong = sum(client.service(name)["service"] != name for _ in range(300))
if child:
    wrong += os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    raise SystemExit(wrong)
os._exit(wrong)
"""
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


def test_what_comes_after_the_end_is_told_to_come_again(robot):
    """It must be told so at once: nobody would ever do it."""
    committer = robot.server.operations.committer
    committer.stop()
    with pytest.raises(Busy):
        committer.submit(lambda asked: asked).result(0)
