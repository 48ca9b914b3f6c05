"""Whoever is inside a container makes of a file what he likes: a probe of it stays inside, and waits for nothing."""

from __future__ import annotations

import os
import sys
import threading
import time

import pytest
from common import wait_for

from rorg.host.container_root import MOST_DEPTH, modified


@pytest.fixture
def root(tmp_path):
    """A directory as the root of somebody, beside files that are not his."""
    (tmp_path / "outside").mkdir()
    (tmp_path / "outside" / "ready").touch()
    found = tmp_path / "root"
    (found / "run" / "deep").mkdir(parents=True)
    (found / "run" / "ready").touch()
    os.utime(found / "run" / "ready", (1000, 1000))
    return found


def link(path, target) -> None:
    path.symlink_to(target)


def test_links_lead_to_places_inside(root):
    for name, target in {
        "absolute": "/run/ready",
        "relative": "run/ready",
        "up": "../../../../run/deep/../ready",
        "twice": "/absolute",
        "folder": "/run/deep/..",
        "dots": "./run//./ready",
    }.items():
        link(root / name, target)
    for path in ("/run/ready", "/absolute", "/relative", "/up", "/twice", "/folder/ready", "/dots", "/../../run/ready"):
        assert modified(str(root), path) == 1000, path
    assert modified(str(root), "/") == os.stat(root).st_mtime


def test_nothing_leads_out(root):
    outside = root.parent / "outside"
    link(root / "absolute", outside / "ready")
    link(root / "up", "../outside/ready")
    link(root / "run" / "folder", f"/../..{outside}")
    link(root / "magic", f"/proc/self/cwd{outside}/ready")
    (root / "proc").mkdir()
    for path in ("/absolute", "/up", "/run/folder/ready", "/magic", str(outside / "ready"), "/../outside/ready"):
        with pytest.raises(OSError, match="No such file"):
            modified(str(root), path)


def test_links_without_end_and_depths_are_errors(root):
    link(root / "itself", "itself")
    link(root / "a", "/b")
    link(root / "b", "/a")
    link(root / "longer", "longer/longer")
    here, was = os.open(root, os.O_PATH), os.getcwd()
    try:
        os.chdir(root)
        for _ in range(MOST_DEPTH + 5):
            os.mkdir("d")
            os.chdir("d")
    finally:
        os.chdir(was)
        os.close(here)
    before = len(os.listdir("/proc/self/fd"))
    for path in ("/itself", "/a", "/longer", "/d" * (MOST_DEPTH + 5), "/run/ready/x", "/" + "n" * 300, "/missing"):
        with pytest.raises(OSError, match="Errno"):
            modified(str(root), path)
    assert len(os.listdir("/proc/self/fd")) <= before


def test_pipes_and_devices_are_looked_at_without_opening_them(root):
    os.mkfifo(root / "pipe")
    for name, number in {"zero": os.makedev(1, 5), "tty": os.makedev(5, 0)}.items():
        try:
            os.mknod(root / name, 0o600 | 0o020000, number)
        except PermissionError:
            pytest.skip("only root makes devices")
    for path in ("/pipe", "/zero", "/tty"):
        assert modified(str(root), path) > 1000


def test_nobody_gets_out_by_moving_things_about(root):
    """A folder that becomes a link between the look at it and the next step."""
    outside = root.parent / "outside"
    os.utime(outside / "ready", (2000, 2000))
    (root / "turn").mkdir()
    (root / "turn" / "ready").touch()
    link(root / "other", outside)
    done = threading.Event()

    def turn() -> None:
        while not done.is_set():
            os.rename(root / "turn", root / "kept")
            os.rename(root / "other", root / "turn")
            os.rename(root / "turn", root / "other")
            os.rename(root / "kept", root / "turn")

    thread = threading.Thread(target=turn)
    was = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    thread.start()
    try:
        end, looks, seen = time.monotonic() + 30, 0, set()
        while time.monotonic() < end and (looks < 5000 or seen != {False, None}):
            looks += 1
            try:
                seen.add(modified(str(root), "/turn/../turn/ready") == 2000)
            except OSError:
                seen.add(None)
        assert True not in seen
        assert seen == {False, None}, "it was there, and turned"
    finally:
        done.set()
        thread.join()
        sys.setswitchinterval(was)


def test_a_link_of_a_container_to_a_file_of_this_machine_is_no_yes(docker_robot, tmp_path):
    secret = tmp_path / "secret"
    program = (
        "import os, signal, time\n"
        "os.makedirs('/run/inner')\n"
        f"os.symlink('{secret}', '/run/out')\n"
        "os.symlink('/run/inner', '/run/way')\n"
        "os.mkfifo('/run/pipe')\n"
        "open('/run/inner/ready', 'w').close()\n"
        "signal.pause()"
    )
    command = ["python3", "-S", "-c", program]
    docker_robot.declare(
        {
            "out": {"command": command, "always_on": True, "ready": {"file": "/run/out"}},
            "way": {"command": command, "always_on": True, "ready": {"file": "/run/way/ready"}},
            "pipe": {"command": command, "always_on": True, "ready": {"file": "/run/pipe"}},
            "late": {"needs": ["out"], "always_on": True},
        }
    )

    def health(name: str) -> str:
        return docker_robot.status().get("services", {}).get(name, {}).get("health", "")

    docker_robot.wait(lambda: {"out", "way", "pipe"} <= docker_robot.active())
    secret.touch()
    docker_robot.wait(lambda: health("way") == health("pipe") == "Healthy")
    docker_robot.wait(lambda: "file /run/out: No such file or directory" in docker_robot.waits("late"))
    assert wait_for(lambda: health("out")) != "Healthy"
