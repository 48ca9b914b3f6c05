"""A person who orders what an interlock refuses hears that at once, and how it goes on."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import commands
import pytest
from common import wait_for
from rorg_process import RorgProcess

from rorg.core.assessment import FRESH

GONE = "No such file or directory"


@pytest.fixture
def parked(tmp_path) -> Path:
    """What the interlock looks at."""
    found = tmp_path / "parked"
    found.touch()
    return found


@pytest.fixture
def robot(tmp_path, parked):
    """With an arm whose interlock allows everything, and a base that has none."""
    lock = {"file": str(parked), "interval": "100ms"}
    found = RorgProcess(tmp_path, {"arm": {"always_on": True, "interlock": lock}, "base": {}}).start()
    wait_for(lambda: (found.state / "run/rorg.sock").exists())
    found.client(patience=10.0).wait("arm", timeout=30)
    ready = time.monotonic()
    wait_for(lambda: time.monotonic() > ready + 0.2 + FRESH, what="that it was allowed to start counts no more")
    yield found
    parked.touch()
    found.close()


def environment(robot: RorgProcess) -> dict[str, str]:
    return {"RORG_STATE_DIR": str(robot.state), "RORG_ENGINE": "process"}


def rorg(robot: RorgProcess, *words: str) -> str:
    """What a command says to people besides its answer."""
    return commands.rorg(*words, cwd=robot.folder, **environment(robot)).stderr


@pytest.mark.slow
@pytest.mark.parametrize("words", [("hold", "arm", "--for", "10m", "--yes"), ("restart", "arm", "--yes")])
def test_an_order_against_an_interlock_says_what_it_waits_for(robot, parked, words):
    parked.unlink()
    said = rorg(robot, *words)
    assert f"arm waits (interlock: file {parked}: {GONE})" in said
    assert "remove the interlock" in said
    assert "waits" not in rorg(robot, "hold", "base", "--for", "10m", "--yes"), "nor what waited before"


@pytest.mark.slow
def test_an_order_that_the_interlock_allows_says_nothing(robot):
    assert "waits" not in rorg(robot, "restart", "arm", "--yes")
    assert "waits" not in rorg(robot, "hold", "arm", "--for", "10m", "--yes")
    wait_for(lambda: robot.client().service("arm")["state"] != "running")


@pytest.mark.slow
@pytest.mark.parametrize("serving", [True, False])
def test_down_says_what_it_waits_for_and_goes_on_when_it_may(robot, parked, serving):
    if not serving:
        robot.stop()
    parked.unlink()
    down = subprocess.Popen(
        [sys.executable, "-m", "rorg", "down", "--yes", "--timeout", "30s"],
        cwd=robot.folder,
        env={**os.environ, **environment(robot)},
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        next(line for line in down.stderr if "to stop and remove" in line)
        began = time.monotonic()
        said = next(line for line in down.stderr if "waits" in line)
        assert time.monotonic() - began < 4, "within 2 s on a quiet machine"
        assert f"arm waits (interlock: file {parked}: {GONE})" in said
        assert down.poll() is None
        parked.touch()
        assert down.wait(60) == 0
    finally:
        down.kill()
        down.wait()


@pytest.mark.slow
def test_down_that_gives_up_says_why(robot, parked):
    parked.unlink()
    done = commands.rorg("down", "--yes", "--timeout", "2s", code=4, cwd=robot.folder, **environment(robot))
    assert f"arm: interlock: file {parked}: {GONE}" in done.stderr.splitlines()[-1]
