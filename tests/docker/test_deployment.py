"""rorg as systemd and as the paper run it."""

from __future__ import annotations

import http.client
import os
import socket
import ssl
import subprocess
import sys

import commands
import docker
import pytest
from certificates import certificate
from common import free_port, wait_for
from robots import RealRobot, write_tree

from rorg.client import Client


@pytest.mark.slow
def test_systemd_hears_that_it_is_ready_alive_and_stopping(tmp_path):
    heard = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    heard.bind(str(tmp_path / "notify"))
    heard.settimeout(20)
    tree = write_tree(tmp_path / "tree", {})
    (tree / "services/camera.yaml").write_text(
        "apiVersion: rorg/v1\nkind: Service\nmetadata: {name: camera}\nspec: {image: x, command: 'true'}\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-m", "rorg", "run", str(tree), "--state-dir", str(tmp_path / "state"), "--engine", "process"],
        env={**os.environ, "NOTIFY_SOCKET": str(tmp_path / "notify"), "WATCHDOG_USEC": "400000"},
        stderr=subprocess.DEVNULL,
    )
    try:
        assert heard.recv(100) == b"READY=1"
        assert [heard.recv(100) for _ in range(3)] == [b"WATCHDOG=1"] * 3
        process.terminate()
        wait_for(lambda: heard.recv(100) == b"STOPPING=1")
        assert process.wait(60) == 0
    finally:
        process.kill()


def test_rorg_runs_in_a_container_and_never_takes_itself_for_a_service(dockerd, rorg_image, tmp_path):
    """With the mounts of docs/how-to/run.md."""
    api = docker.APIClient(dockerd.host, version="auto")
    robot = RealRobot(tmp_path, "docker", dockerd.host)
    write_tree(robot.tree, {"camera": {}, "lidar": {"always_on": True}})
    engine = str(dockerd.folder) if hasattr(dockerd, "folder") else "/var/run"
    made = api.create_container(
        rorg_image,
        ["run", str(robot.tree), "--engine", "docker"],
        environment={"RORG_STATE_DIR": str(robot.state.path), "DOCKER_HOST": dockerd.host},
        host_config=api.create_host_config(
            network_mode="host",
            pid_mode="host",
            binds=[f"{engine}:{engine}", f"{tmp_path}:{tmp_path}", "/sys/fs/cgroup:/sys/fs/cgroup:ro"],
        ),
    )["Id"]
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


def test_a_robot_that_was_taken_down_stays_down_though_the_engine_restarts_rorg(dockerd, rorg_image, tmp_path):
    """With the restart policy of docs/how-to/run.md."""
    api = docker.APIClient(dockerd.host, version="auto")
    robot = RealRobot(tmp_path, "docker", dockerd.host)
    write_tree(robot.tree, {"ra": {"always_on": True}, "rb": {"always_on": True, "needs": ["ra"]}})
    engine = str(dockerd.folder) if hasattr(dockerd, "folder") else "/var/run"
    mounts = [f"{engine}:{engine}", f"{tmp_path}:{tmp_path}", "/run/rorg:/run/rorg", "/sys/fs/cgroup:/sys/fs/cgroup:ro"]
    made = api.create_container(
        rorg_image,
        ["run", str(robot.tree), "--engine", "docker"],
        environment={"RORG_STATE_DIR": str(robot.state.path), "DOCKER_HOST": dockerd.host},
        host_config=api.create_host_config(
            network_mode="host", pid_mode="host", binds=mounts, restart_policy={"Name": "unless-stopped"}
        ),
    )["Id"]

    def said(*words: str) -> str:
        return commands.rorg(*words, cwd=tmp_path, RORG_STATE_DIR=str(robot.state.path)).stderr

    try:
        api.start(made)
        client = Client(robot.socket(), patience=60)
        client.wait("rb", timeout=60)
        assert "the robot is down" in said("down", "--yes", "--timeout", "60s")
        wait_for(lambda: api.inspect_container(made)["RestartCount"] > 0)
        for restart in (lambda: None, lambda: api.restart(made, timeout=10)):
            restart()
            wait_for(lambda: client.status()["services"])
            assert client.status()["down"] == "down"
            assert not robot.containers()
            assert "rorg up" in said("get")
        said("up")
        client.wait("rb", timeout=60)
        assert robot.active() == {"ra", "rb"}
    except Exception:
        print(api.logs(made).decode())
        raise
    finally:
        api.remove_container(made, force=True)
        robot.close()


def ask_without_tls(port: int) -> int:
    plain = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    plain.request("GET", "/v1/services")
    return plain.getresponse().status


@pytest.mark.slow
def test_tcp_only_with_tls_and_a_client_certificate(tmp_path):
    for name, authority in (("authority", ""), ("stranger", ""), ("robot", "authority"), ("ada", "authority")):
        certificate(tmp_path, name, authority)
    tree, port = write_tree(tmp_path / "tree", {"camera": {}}), free_port()
    base = [
        sys.executable,
        "-m",
        "rorg",
        "run",
        str(tree),
        "--state-dir",
        str(tmp_path / "state"),
        "--engine",
        "process",
        "--listen",
        f"127.0.0.1:{port}",
    ]
    refused = subprocess.run(base, capture_output=True, text=True)
    assert refused.returncode == 2
    assert "only served with TLS and client certificates" in refused.stderr
    process = subprocess.Popen(
        [
            *base,
            "--tls-cert",
            tmp_path / "robot.pem",
            "--tls-key",
            tmp_path / "robot.key",
            "--tls-ca",
            tmp_path / "authority.pem",
        ],
        stderr=subprocess.DEVNULL,
    )

    def ask(who: str, method: str = "GET", path: str = "/v1/services", body: str | None = None) -> int:
        context = ssl.create_default_context(cafile=tmp_path / "authority.pem")
        if who:
            context.load_cert_chain(tmp_path / f"{who}.pem", tmp_path / f"{who}.key")
        connection = http.client.HTTPSConnection("127.0.0.1", port, context=context, timeout=60)
        connection.request(method, path, body, {"content-type": "application/json"})
        return connection.getresponse().status

    try:
        Client(str(tmp_path / "state/run/rorg.sock"), patience=20).services()
        assert ask("ada") == 200
        for who in ("", "stranger"):
            with pytest.raises((ssl.SSLError, OSError)):
                ask(who)
        with pytest.raises((http.client.HTTPException, OSError)):
            ask_without_tls(port)
        assert ask("ada", "PUT", "/v1/requests/look", '{"services": ["camera"]}') == 200
        events = Client(str(tmp_path / "state/run/rorg.sock")).events(tail=50)
        assert any(e["kind"] == "request" and e["author"] == "ada" for e in events)
    finally:
        process.terminate()
        process.wait(60)
        from rorg.engines.make import make_engine
        from rorg.store.state_dir import StateDir

        engine = make_engine("process", StateDir(tmp_path / "state"))
        for container in engine.list():
            engine.stop(container.id, "SIGKILL", 5.0)
