"""A robot whose server is under attack, and a caller beside the attackers."""

from __future__ import annotations

import resource
import time

import psutil
import pytest
from certificates import certificate
from common import free_port
from floods import flooding
from histories import write_many
from rorg_process import RorgProcess

FILES = 700
"""Descriptors of the rorg of these tests."""

MOST_MEMORY = 150 << 20

TREE = {
    "alpha": {"always_on": True, "may_request": ["camera"]},
    "beta": {"always_on": True, "may_request": ["camera"]},
    "gamma": {"always_on": True, "may_request": ["camera"]},
    "camera": {},
    "probed": {"ready": {"tcp": 9}},
    "lidar": {"idle": {"action": "pause", "linger": 0}},
    **{f"other-{n}": {} for n in range(40)},
}


class Robot(RorgProcess):
    """Also on TCP, with few descriptors and a long journal."""

    def begin(self) -> Robot:
        (self.state).mkdir()
        message = "x" * 500
        write_many(self.state / "journal.db", 12_000, message=message, service="alpha")
        self.start(preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_NOFILE, (FILES, FILES)))
        self.client(patience=60).wait("alpha", "beta", "gamma", timeout=60)
        return self

    @property
    def memory(self) -> int:
        return psutil.Process(self.process.pid).memory_info().rss

    def log(self) -> int:
        """Bytes that it has said."""
        return (self.folder / "rorg.log").stat().st_size

    def others(self) -> None:
        """A person and another service are answered, and what is changed is acted on."""
        with self.client(patience=20).request("camera", wait=20):
            assert self.client("beta", patience=20).service("camera")["state"] == "running"
        assert self.memory < MOST_MEMORY


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    folder = tmp_path_factory.mktemp("robot")
    for name, authority in (("ca", ""), ("server", "ca"), ("laptop", "ca")):
        certificate(folder, name, authority)
    port = free_port()
    files = {"--tls-cert": "server.pem", "--tls-key": "server.key", "--tls-ca": "ca.pem"}
    options = [part for option, name in files.items() for part in (option, str(folder / name))]
    found = Robot(folder, TREE, "--listen", f"127.0.0.1:{port}", *options)
    found.port = port
    try:
        yield found.begin()
    finally:
        found.close()


def beside(robot, kind: str, rounds: int, each: int) -> tuple[list[float], list[float]]:
    """Seconds from a person's request to ready, without and with a service that floods."""
    client = robot.client(patience=60)

    def cycle() -> float:
        began = time.monotonic()
        with client.request("lidar", wait=30):
            return time.monotonic() - began

    quiet, loud = list[float](), list[float]()
    for _ in range(rounds):
        quiet += [cycle() for _ in range(each)]
        with flooding(robot.socket("alpha"), kind):
            loud += [cycle() for _ in range(each)]
    return quiet, loud
