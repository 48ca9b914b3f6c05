"""An engine on another machine: nothing of this one, no process, no file, no port, is taken for a container's."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from contextlib import ExitStack

import pytest
from common import free_port, wait_for
from forwarder import Forwarder
from robots import RealRobot, write_tree

from rorg.client import Error
from rorg.core.observed import LABEL_OWNER, LABEL_SERVICE
from rorg.daemon.wiring import make_loop
from rorg.engines.docker.engine import DockerEngine
from rorg.engines.make import make_engine
from rorg.model.probe import Probe
from rorg.probes.ask import asks_this_machine
from rorg.store.state_dir import StateDir
from rorg.tools.sim.engine import SimEngine

ELSEWHERE = "cannot ask: the engine is on another machine"


@pytest.fixture
def victim():
    """A process of this machine whose number the engine gives for all of its own."""
    found = subprocess.Popen([sys.executable, "-c", "import signal\nwhile True: signal.pause()"])
    yield found
    found.kill()
    found.wait()


@pytest.fixture
def remote(dockerd, victim, tmp_path):
    with ExitStack() as stack:
        forwarder = Forwarder(dockerd.host, victim.pid)
        stack.callback(forwarder.close)
        found = RealRobot(tmp_path, "docker", forwarder.host, with_server=True)
        stack.callback(found.close)
        yield found


def test_no_process_of_this_machine_is_taken_for_a_containers(remote, victim, tmp_path):
    ready = tmp_path / "ready"
    remote.declare(
        {
            "filer": {"ready": {"file": str(ready)}},
            "client": {"needs": ["filer"]},
            "idler": {"idle": {"action": "pause", "reclaim": True}},
        },
        policies={"policy": {"budget": {"cpu": 0.001}, "pressure": {"step": "200ms"}}},
    )
    ready.touch()
    remote.request("client")
    remote.request("idler", id="idler")
    remote.wait(lambda: ELSEWHERE in remote.waits("client"))
    remote.wait(lambda: {"filer", "idler"} <= remote.active())
    containers = remote.containers()
    assert {c.pid for c in containers} == {0}
    assert remote.engine.usage(containers) == {}
    assert remote.loop.running.use() == {}
    remote.release("idler")
    remote.wait(lambda: remote.states()["idler"] == "paused")
    filer = remote.container("filer").id
    code, _ = remote.engine.exec(filer, ["python3", "-S", "-c", "import signal; signal.pause()"], 0.5)
    assert code == 124
    assert victim.poll() is None
    assert next(remote.engine.log_since(filer, ""))[0] == b""
    with socket.create_server(("127.0.0.1", 0)) as listener, pytest.raises(Error, match="on another machine"):
        remote.client().call("GET", f"/v1/listeners/{listener.getsockname()[1]}")
    assert remote.loop.sampler.latest is None, "the load of this machine is not that one's"
    assert not any("swap" in line or "stays:" in line for line in remote.log())


def test_no_port_of_this_machine_is_taken_for_a_services(remote):
    port = free_port()
    with socket.create_server(("127.0.0.1", port)), socket.create_server(("0.0.0.0", 0)) as everywhere:
        there = f"{_own_address()}:{everywhere.getsockname()[1]}"
        remote.declare(
            {
                "porter": {"ready": {"tcp": port}},
                "pager": {"ready": {"http": f"http://localhost:{port}/"}},
                "named": {"ready": {"tcp": there}},
                "aa": {"needs": ["porter"]},
                "bb": {"needs": ["pager"]},
                "cc": {"needs": ["named"]},
            }
        )
        remote.request("aa", "bb", "cc")
        remote.wait(lambda: ELSEWHERE in remote.waits("aa") and ELSEWHERE in remote.waits("bb"))
        if not asks_this_machine(Probe("tcp", there)):
            remote.wait(lambda: "cc" in remote.active())


def _own_address() -> str:
    """An address of this machine that is not the loopback's, where it has one."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing
        except OSError:
            return "127.0.0.1"
        return str(probe.getsockname()[0])


@pytest.mark.parametrize(
    ("probe", "here"),
    [
        (Probe("tcp", "80"), True),
        (Probe("tcp", "localhost:80"), True),
        (Probe("tcp", "127.0.0.1:80"), True),
        (Probe("tcp", "[::1]:80"), True),
        (Probe("tcp", "robot:80"), False),
        (Probe("tcp", "192.0.2.7:80"), False),
        (Probe("http", "http://localhost:80/health"), True),
        (Probe("http", "http://127.3.2.1/health"), True),
        (Probe("http", "http://robot/localhost"), False),
        (Probe("ros_node", "/localhost", graph="http://robot:11311"), False),
        (Probe("ros_node", "/robot", graph="http://localhost:11311"), True),
    ],
    ids=str,
)
def test_which_probes_are_about_this_machine(probe, here):
    assert asks_this_machine(probe) is here


@pytest.mark.parametrize(
    ("host", "local"),
    [
        ("unix:///run/docker.sock", True),
        ("http+unix:///run/docker.sock", True),
        ("tcp://127.0.0.1:2375", False),
        ("tcp://robot:2376", False),
        ("ssh://robot", False),
        ("robot:2375", False),
        ("", True),
    ],
)
def test_which_engines_are_on_this_machine(host, local):
    before = os.environ.get("DOCKER_HOST")
    assert DockerEngine("me", host or "unix:///run/docker.sock").local is local
    try:
        os.environ["DOCKER_HOST"] = host
        assert DockerEngine("me").local is local
    finally:
        os.environ.pop("DOCKER_HOST")
        if before is not None:
            os.environ["DOCKER_HOST"] = before


def test_the_process_engine_is_on_this_machine(tmp_path):
    assert make_engine("process", StateDir(tmp_path / "state").prepare()).local


def test_two_containers_of_one_service_use_what_both_use(tmp_path):
    state = StateDir(tmp_path / "state").prepare()
    engine = SimEngine("me", lambda: now[0])
    now, engine.needs["camera"] = [0.0], (0.5, 100)
    loop = make_loop(write_tree(tmp_path / "tree", {"camera": {}}), state, engine, lambda line: None)
    for name, begin in (("camera", 0.0), ("camera.old", 2.0)):
        now[0] = begin
        engine.start(engine.create(name, {"image": "x"}, {LABEL_OWNER: "me", LABEL_SERVICE: "camera"}))
    now[0] = 4.0
    loop.observer.sync()
    wait_for(lambda: len(loop.observer.snapshot().containers) == 2)
    assert loop.running.use() == {"camera": (3.0, 200)}
