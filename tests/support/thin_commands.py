"""Everyday commands against a running rorg, and what they import."""

from __future__ import annotations

import os
import subprocess
import sys

import commands
import pytest
from robots import RealRobot

HEAVY = ("argparse", "rich", "pydantic", "yaml", "docker", "psutil", "asyncio", "ssl", "email", "http")

ROOMS = ("api", "sim", "daemon", "images", "probes", "host", "manifest", "core")

SERVICES = {
    "roscore": {},
    "navigation": {"needs": ["roscore"]},
    "base": {"always_on": True},
    "spare": {"always_on": True, "ready": {"delay": "0s"}},
}

GROUPS = {"driving": {"services": ["navigation"]}}


@pytest.fixture
def robot(tmp_path):
    """A loop with its API, in this process."""
    found = RealRobot(tmp_path, "process", None, with_server=True)
    found.declare(SERVICES, groups=GROUPS)
    found.wait(lambda: {"base", "spare"} <= found.active())
    found.settle()
    yield found
    found.close()


def rorg(robot: RealRobot, *words: str, code: int = 0, **environment: str) -> subprocess.CompletedProcess:
    environment = {"RORG_STATE_DIR": str(robot.state.path), "RORG_ENGINE": "process", **environment}
    return commands.rorg(*words, code=code, **environment)


def imported(robot: RealRobot, *words: str, code: int = 0, **environment: str) -> set[str]:
    """The modules that a command has imported at its end."""
    report = robot.state.path.parent / "modules"
    hook = (
        "import atexit, pathlib, sys\n"
        f"atexit.register(lambda: pathlib.Path({str(report)!r}).write_text(' '.join(sys.modules)))\n"
        "sys.argv = ['rorg', *sys.argv[1:]]\n"
        "from rorg.cli.main import run\nrun()"
    )
    done = subprocess.run(
        [sys.executable, "-c", hook, *words],
        capture_output=True,
        text=True,
        timeout=60,
        stdin=subprocess.DEVNULL,
        env={**os.environ, "RORG_STATE_DIR": str(robot.state.path), "RORG_ENGINE": "process", **environment},
    )
    assert done.returncode == code, f"exit {done.returncode}\n{done.stdout}\n{done.stderr}"
    return set(report.read_text().split())


def heavy(modules: set[str]) -> list[str]:
    return sorted(m for m in modules if m.split(".")[0] in HEAVY or m.split(".")[:2] in [["rorg", r] for r in ROOMS])
