"""Commands that wait, and the robot that they ask."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import pytest
from common import readable
from robots import RealRobot

SERVICES = {
    "base": {"always_on": True},
    "arm": {},
    "missing": {"command": ["there-is-no-such-program"]},
    "guide": {"needs": ["missing"]},
    "failing": {"command": ["sh", "-c", "exit 3"], "ready": {"delay": "5s"}},
    "once": {"command": ["sh", "-c", "exit 3"], "ready": {"delay": "5s"}, "restart": "never"},
    "nav": {"needs": ["slow"]},
}


@pytest.fixture
def ready(tmp_path):
    """The file that makes the service `slow` ready."""
    return tmp_path / "ready"


@pytest.fixture
def robot(tmp_path, ready):
    """A loop with its API, in this process."""
    found = RealRobot(tmp_path, "process", None, with_server=True)
    slow = {"ready": {"file": str(ready), "timeout": "60s"}}
    found.declare({**SERVICES, "slow": slow}, groups={"all": {"services": ["nav"]}})
    found.wait(lambda: "base" in found.active())
    yield found
    found.close()


def requests(robot: RealRobot) -> dict[str, list[str]]:
    return {r["id"]: r["services"] for r in robot.client().requests() if not r["standing"]}


def begin(robot: RealRobot, *words: str, **more) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "rorg", *words],
        text=True,
        env={**os.environ, "RORG_STATE_DIR": str(robot.state.path), "RORG_ENGINE": "process", "TERM": "xterm"},
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "stdin": subprocess.DEVNULL, **more},
    )


def read(main: int, until: str, seconds: float = 30.0) -> str:
    found, end = "", time.monotonic() + seconds
    while until not in found and time.monotonic() < end:
        if readable(main, 0.2):
            try:
                found += os.read(main, 65536).decode()
            except OSError:  # the other side is closed
                break
    return found
