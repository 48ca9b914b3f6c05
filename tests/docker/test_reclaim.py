"""Memory of paused services is pushed out to swap, where the machine has some."""

from __future__ import annotations

import os
import re
import subprocess

import pytest
from common import wait_for

from rorg.host.cgroups import has_swap

HOARD = [
    "python3",
    "-S",
    "-c",
    "import os, signal\nsignal.signal(2, lambda *_: os._exit(0))\n"
    "x = bytearray(os.urandom(64 << 20))\nwhile True: signal.pause()",
]


@pytest.fixture
def swap(tmp_path):
    """Some swap space, for as long as the test runs."""
    if has_swap():
        yield
        return
    path = tmp_path / "swap"
    with path.open("wb") as file:
        os.posix_fallocate(file.fileno(), 0, 256 << 20)
    path.chmod(0o600)
    if (
        os.geteuid() != 0
        or subprocess.run(["mkswap", path], capture_output=True).returncode
        or subprocess.run(["swapon", path], capture_output=True).returncode
    ):
        pytest.skip("no swap space can be made here")
    yield
    # It is refused while other tests hold so much memory that theirs might not come back.
    wait_for(
        lambda: subprocess.run(["swapoff", path], capture_output=True).returncode == 0, 120, "swap to be given back"
    )


def test_a_paused_service_gives_its_memory_back_and_comes_back_whole(docker_robot, swap):
    docker_robot.declare({"hoarder": {"command": HOARD, "idle": {"action": "pause", "reclaim": True}}})
    docker_robot.request("hoarder")
    docker_robot.wait(lambda: _memory(docker_robot) > 60 << 20)
    before = docker_robot.container("hoarder").incarnation
    docker_robot.release()
    docker_robot.wait(lambda: any("pushed out to swap" in line for line in docker_robot.log()))
    said = next(line for line in docker_robot.log() if "pushed out" in line)
    assert re.match(r"\d+Mi of hoarder pushed out to swap", said)
    assert int(said.split("Mi")[0]) > 32
    assert _memory(docker_robot) < 32 << 20
    docker_robot.request("hoarder")
    docker_robot.wait(lambda: "hoarder" in docker_robot.active())
    assert docker_robot.container("hoarder").incarnation == before


def _memory(robot) -> int:
    found = [c for c in robot.containers() if c.service == "hoarder" and c.alive]
    usage = robot.engine.usage(found)
    return usage[found[0].id].memory if found and found[0].id in usage else 0
