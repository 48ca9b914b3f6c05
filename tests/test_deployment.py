"""rorg as systemd and as the paper run it."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import sysconfig

import docker
import pytest
from conftest import ROOT, wait_for
from robots import RealRobot, write_tree

from rorg.client import Client


def test_systemd_hears_that_it_is_ready_alive_and_stopping(tmp_path):
    heard = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    heard.bind(str(tmp_path / "notify"))
    heard.settimeout(20)
    tree = write_tree(tmp_path / "tree", {})
    (tree / "services/camera.yaml").write_text(
        "apiVersion: rorg/v1\nkind: Service\nmetadata: {name: camera}\nspec: {image: x, command: 'true'}\n")
    process = subprocess.Popen(
        [sys.executable, "-m", "rorg", "run", str(tree), "--state-dir", str(tmp_path / "state"), "--engine", "process"],
        env={**os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "400000"},
        stderr=subprocess.DEVNULL)
    try:
        assert heard.recv(100) == b"READY=1"
        assert [heard.recv(100) for _ in range(3)] == [b"WATCHDOG=1"] * 3
        process.terminate()
        wait_for(lambda: heard.recv(100) == b"STOPPING=1")
        assert process.wait(20) == 0
    finally:
        process.kill()


def test_rorg_runs_in_a_container_and_never_takes_itself_for_a_service(dockerd, ros_image, tmp_path):
    """With the mounts of docs/how-to/run.md; its packages come from this machine instead of an image's build, on a
    Debian that has Python."""
    if sys.version_info[:2] != (3, 11):
        pytest.skip("the image's Python is 3.11, and takes only packages for that")
    api = docker.APIClient(dockerd.host, version="auto")
    robot = RealRobot(tmp_path, "docker", dockerd.host)
    write_tree(robot.tree, {"camera": {}, "lidar": {"always_on": True}})
    engine = str(dockerd.folder) if hasattr(dockerd, "folder") else "/var/run"
    packages = sysconfig.get_path("purelib")
    made = api.create_container(
        ros_image, ["python3", "-m", "rorg", "run", str(robot.tree), "--engine", "docker"],
        environment={"RORG_STATE_DIR": str(robot.state.path), "DOCKER_HOST": dockerd.host,
                     "PYTHONPATH": f"{ROOT}:{packages}"},
        host_config=api.create_host_config(network_mode="host", pid_mode="host", binds=[
            f"{engine}:{engine}", f"{tmp_path}:{tmp_path}", "/sys/fs/cgroup:/sys/fs/cgroup:ro",
            f"{ROOT / 'rorg'}:{ROOT / 'rorg'}:ro", f"{packages}:{packages}:ro"]))["Id"]
    try:
        api.start(made)
        client = Client(robot.socket(), patience=30)
        try:
            client.services()
        except Exception:
            print(api.logs(made).decode())
            raise
        with client.request("camera", wait=30):
            wait_for(lambda: robot.active() == {"camera", "lidar"})
        wait_for(lambda: robot.active() == {"lidar"})
        assert client.usage()["services"]["lidar"]["memory"] > 0
        before = robot.container("lidar").incarnation
        api.restart(made, timeout=5)
        with client.request("camera", wait=30):
            assert robot.container("lidar").incarnation == before
        assert made not in {c.id for c in robot.containers()}
        assert api.inspect_container(made)["State"]["Running"]
    finally:
        api.remove_container(made, force=True)
        robot.close()
