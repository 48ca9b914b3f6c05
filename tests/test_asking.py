"""Commands that wait for what they ask for: progress, ends that cannot be, and what becomes of the request."""

from __future__ import annotations

import os
import pty
import re
import signal
import subprocess
import sys
import time

import pytest
from conftest import readable, wait_for
from robots import RealRobot
from test_thin_commands import rorg

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


# -- what cannot be ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["missing", "guide", "failing", "once"])
def test_a_wait_ends_at_once_where_it_cannot_succeed(robot, name):
    began = time.monotonic()
    said = rorg(robot, "request", name, "--wait", "--timeout", "55", code=4).stderr
    assert time.monotonic() - began < 40, "it waits for what does not get ready"
    assert ("there-is-no-such-program" if name in ("missing", "guide") else "exit code 3") in said
    error, stays = said.splitlines()
    assert error.startswith("rorg: cannot wait for")
    assert stays == f"request '{name}' stays; `rorg release {name}` withdraws it"
    assert name in requests(robot)


def test_a_program_that_is_there_by_the_next_request_is_tried_at_once(robot, tmp_path):
    program = tmp_path / "program"
    robot.declare({**SERVICES, "slow": {}, "later": {"command": [str(program)]}})
    wait_for(lambda: any(s["service"] == "later" for s in robot.client().services()))
    rorg(robot, "request", "later", "--wait", code=4)
    rorg(robot, "release", "later")
    program.write_text("#!/bin/sh\nexec sleep 1000\n")
    program.chmod(0o755)
    rorg(robot, "request", "later", "--wait", "--timeout", "30")


# -- rollback ------------------------------------------------------------------------------------------------------


def test_a_rollback_withdraws_a_request_that_fails(robot):
    said = rorg(robot, "request", "missing", "--wait", "--rollback", code=4).stderr
    assert said.splitlines()[-1] == "request 'missing' is withdrawn"
    assert requests(robot) == {}
    assert "--wait" in rorg(robot, "request", "arm", "--rollback", code=2).stderr


def test_a_rollback_brings_back_what_the_request_replaced(robot):
    rorg(robot, "request", "arm", "--id", "tour", "--reason", "a visitor", "--wait")
    said = rorg(robot, "request", "arm", "missing", "--id", "tour", "--wait", "--rollback", code=4).stderr
    assert said.splitlines()[-1] == "request 'tour' is as it was before"
    assert requests(robot) == {"tour": ["arm"]}
    assert robot.client().requests()[0]["reason"] == "a visitor"


@pytest.mark.parametrize("rollback", [True, False])
def test_an_interrupt_says_what_becomes_of_the_request(robot, rollback):
    process = begin(robot, "request", "nav", "--wait", *(["--rollback"] if rollback else []))
    robot.wait(lambda: "nav" in requests(robot) and "slow" in robot.active())
    robot.wait(lambda: robot.loop.questions)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=30)
    assert process.returncode == 130
    assert said == "request 'nav' " + ("is withdrawn\n" if rollback else "stays; `rorg release nav` withdraws it\n")
    assert requests(robot) == ({} if rollback else {"nav": ["nav"]})


# -- progress --------------------------------------------------------------------------------------------------------


def read(main: int, until: str, seconds: float = 30.0) -> str:
    found, end = "", time.monotonic() + seconds
    while until not in found and time.monotonic() < end:
        if readable(main, 0.2):
            try:
                found += os.read(main, 65536).decode()
            except OSError:  # the other side is closed
                break
    return found


def test_a_terminal_shows_who_waits_for_whom_and_is_left_clean(robot, ready):
    main, other = pty.openpty()
    process = begin(robot, "request", "all", "--id", "tour", "--wait", stderr=other)
    said = read(main, "nav: slow")
    assert re.search(r"\d of 2 ready, \d+ s", said)
    assert re.search(r"nav: slow is not ready \(.* of 60 s\)", said), said
    assert "slow: " in said
    ready.touch()
    assert process.wait(30) == 0
    os.close(other)
    said += read(main, "never said")
    drawn = said.count("\n")
    erased = sum(int(n) for n in re.findall(r"\x1b\[(\d+)A", said))
    assert drawn == erased, "every line that was drawn is taken away"
    os.close(main)


def test_progress_is_for_terminals_alone(robot, ready):
    process = begin(robot, "request", "nav", "--wait")
    robot.wait(lambda: "slow" in robot.active() and robot.loop.questions)
    assert wait_for(
        lambda: any("slow is not ready" in r for why in robot.loop.decision.plan.reasons().values() for r in why)
    )
    ready.touch()
    out, said = process.communicate(timeout=30)
    assert (process.returncode, out, said) == (0, "request 'nav' of developer: nav\n", "")
