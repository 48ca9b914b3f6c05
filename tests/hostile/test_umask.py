"""rorg's files are private, and its sockets reached by those who may, whatever umask it was begun with."""

from __future__ import annotations

import contextlib
import grp
import json
import os
import shutil
import socket
import stat
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from common import wait_for
from robots import write_tree

from rorg.client import Client
from rorg.engines.make import make_engine
from rorg.store.state_dir import StateDir

STRANGER = 54321
"""No user's number, and no group's."""
TREE = {"alpha": {"always_on": True, "may_request": ["camera"]}, "camera": {}, "lidar": {}}
FILES = {0o600, 0o640}
FOLDERS = {0o700, 0o750}

pytestmark = pytest.mark.skipif(os.geteuid() != 0, reason="only root can be somebody else")


@pytest.fixture
def folder():
    """One that others may enter, unlike pytest's."""
    made = Path(tempfile.mkdtemp(prefix="rorg-umask."))
    made.chmod(0o755)
    yield made
    shutil.rmtree(made)


class Robot:
    def __init__(self, folder: Path, umask: int, group: str) -> None:
        self.state, self.run = folder / "below" / "state", folder / "sockets" / "run"
        self.tree = write_tree(folder / "tree", TREE)
        git = ["git", "-C", str(self.tree), "-c", "user.name=x", "-c", "user.email=x@x"]
        for words in (["init", "-q"], ["add", "."], ["commit", "-qm", "all"]):
            subprocess.run([*git, *words], check=True)
        command = [sys.executable, "-m", "rorg", "run", self.tree, "--state-dir", self.state, "--engine", "process"]
        self.process = subprocess.Popen(
            [*command, "--group", group],
            env={**os.environ, "RORG_RUN_DIR": str(self.run)},
            umask=umask,
            stderr=subprocess.DEVNULL,
        )
        self.client = Client(str(self.run / "rorg.sock"), patience=60)

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        engine = make_engine("process", StateDir(self.state))
        for container in engine.list():
            engine.stop(container.id, "SIGKILL", 5.0)
            engine.remove(container.id)


def as_somebody(what, *args, group: int = STRANGER, where: Path = Path("/")) -> object:
    """What a function answers in a process of another user, who stands in a directory: as in a mounted one, whatever
    is above it."""
    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.chdir(where)
            os.setgroups([])
            os.setgid(group)
            os.setuid(STRANGER)
            try:
                found = what(*args)
            except OSError as error:
                found = type(error).__name__
            os.write(write, json.dumps(found).encode())
        finally:
            os._exit(0)
    os.close(write)
    with os.fdopen(read) as pipe:
        found = pipe.read()
    os.waitpid(child, 0)
    return json.loads(found)


def asked(address: str) -> int:
    with socket.socket(socket.AF_UNIX) as connection:
        connection.settimeout(20)
        connection.connect(address)
        connection.sendall(b"GET /v1/services/camera HTTP/1.1\r\nhost: x\r\n\r\n")
        return int(connection.recv(1000).split(b" ")[1])


def opened(paths: list[str], mode: str) -> list[str]:
    """Those of these files that can be opened."""
    found = []
    for path in paths:
        try:
            open(path, mode).close()
        except OSError:
            continue
        found.append(path)
    return found


def mode(path: Path) -> int:
    return stat.S_IMODE(path.lstat().st_mode)


@pytest.mark.slow
@pytest.mark.parametrize("umask", [0o000, 0o027, 0o077], ids=oct)
def test_files_are_private_and_sockets_are_reached_whatever_the_umask(folder, umask):
    group = next(g for g in grp.getgrall() if g.gr_gid not in (0, STRANGER))
    robot = Robot(folder, umask, group.gr_name)
    try:
        use(robot)
        files_are_private(robot)
        those_who_may_get_in(robot, group.gr_gid)
        manifests_can_be_read_by_those_who_could(robot)
    finally:
        robot.close()


def use(robot: Robot) -> None:
    """All that writes files."""
    client = robot.client
    (robot.tree / "services/camera.yaml").chmod(0o664)
    os.chown(robot.tree / "services/camera.yaml", STRANGER, STRANGER)
    client.request("camera", id="look", wait=30, ttl=None)
    for name in ("camera", "radar"):
        known = next((m["digest"] for m in client.manifests() if m["name"] == name), None)
        text = client.manifest("Service", "lidar").replace("name: lidar", f"name: {name}")
        client.put_manifest("Service", name, text, known)
    shutil.rmtree(robot.tree / "groups")
    group = "apiVersion: rorg/v1\nkind: Group\nmetadata: {name: seeing}\nspec: {services: [camera]}\n"
    client.put_manifest("Group", "seeing", group, None)
    wait_for(lambda: (robot.run / "services/alpha/rorg.sock").exists())
    pid = client.service("camera")["pid"]
    os.killpg(pid, 15)
    wait_for(lambda: client.service("camera")["pid"] not in (0, pid))
    wait_for(lambda: (robot.state / "status.json").exists() and (robot.state / ".services.last-good.json").exists())


def files_are_private(robot: Robot) -> None:
    below = [robot.state, *robot.state.rglob("*")]
    assert {p.name for p in below} >= {
        "journal.db",
        "requests.yaml",
        "status.json",
        "instance",
        "record.json",
        "log",
    }
    wrong = {}
    for path in below:
        with contextlib.suppress(FileNotFoundError):  # it was on its way to its place
            if not path.is_socket() and mode(path) not in (FOLDERS if path.is_dir() else FILES):
                wrong[str(path)] = oct(mode(path))
    assert not wrong
    assert mode(robot.state.parent) == mode(robot.run.parent) == mode(robot.run) == 0o755
    assert mode(robot.state / "wakeup") == mode(robot.run / "rorg.sock") == 0o660
    assert mode(robot.run / "services") == 0o700
    assert mode(robot.run / "services/alpha") == 0o755
    assert mode(robot.run / "services/alpha/rorg.sock") == 0o666


def those_who_may_get_in(robot: Robot, group: int) -> None:
    main, own = robot.run / "rorg.sock", robot.run / "services/alpha"
    assert as_somebody(asked, str(main), group=group) == 200, "a member of the group"
    assert as_somebody(asked, str(main)) == "PermissionError", "a stranger"
    assert as_somebody(asked, str(own / "rorg.sock"), group=group) == "PermissionError", "a service's is not for others"
    assert as_somebody(asked, "rorg.sock", where=own) == 200, "whoever is in the service's container"
    assert as_somebody(opened, ["mine"], "w", where=own) == []
    paths = [str(p) for p in robot.state.rglob("*") if p.is_file()]
    for gid in (group, STRANGER):
        assert as_somebody(opened, paths, "rb", group=gid) == []
        assert as_somebody(opened, paths, "ab", group=gid, where=robot.state) == []


def manifests_can_be_read_by_those_who_could(robot: Robot) -> None:
    kept, new = robot.tree / "services/camera.yaml", robot.tree / "services/radar.yaml"
    assert (mode(kept), kept.stat().st_uid, kept.stat().st_gid) == (0o664, STRANGER, STRANGER)
    assert mode(new) == mode(robot.tree / "groups/seeing.yaml") == 0o644
    assert mode(robot.tree / "groups") == 0o755
    objects = [p for p in (robot.tree / ".git").rglob("*") if mode(p) & 0o022 and not p.is_symlink()]
    assert not objects
