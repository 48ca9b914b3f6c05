"""Commands that wait for what they ask for: progress, ends that cannot be, and what becomes of the request."""

from __future__ import annotations

import os
import pty
import re
import signal
import subprocess
import sys
import threading
import time

import pytest
from common import wait_for
from rorg_process import RorgProcess
from thin_commands import rorg
from waiting_commands import SERVICES, begin, read, ready, requests, robot  # noqa: F401

from rorg.store.state_dir import StateDir

# -- what cannot be ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["missing", "guide", "failing", "once"])
def test_a_wait_ends_at_once_where_it_cannot_succeed(robot, name):  # noqa: F811
    began = time.monotonic()
    said = rorg(robot, "request", name, "--wait", "--timeout", "55", code=4).stderr
    assert time.monotonic() - began < 40, "it waits for what does not get ready"
    assert ("there-is-no-such-program" if name in ("missing", "guide") else "exit code 3") in said
    error, stays = said.splitlines()
    assert error.startswith("rorg: cannot wait for")
    assert stays == f"request '{name}' stays; `rorg release {name}` withdraws it"
    assert name in requests(robot)


def test_a_program_that_is_there_by_the_next_request_is_tried_at_once(robot, tmp_path):  # noqa: F811
    program = tmp_path / "program"
    robot.declare({**SERVICES, "slow": {}, "later": {"command": [str(program)]}})
    wait_for(lambda: any(s["service"] == "later" for s in robot.client().services()))
    rorg(robot, "request", "later", "--wait", code=4)
    rorg(robot, "release", "later")
    program.write_text("#!/bin/sh\nexec sleep 1000\n")
    program.chmod(0o755)
    rorg(robot, "request", "later", "--wait", "--timeout", "30")


# -- rollback ------------------------------------------------------------------------------------------------------


def test_a_rollback_withdraws_a_request_that_fails(robot):  # noqa: F811
    said = rorg(robot, "request", "missing", "--wait", "--rollback", code=4).stderr
    assert said.splitlines()[-1] == "request 'missing' is withdrawn"
    assert requests(robot) == {}
    assert "--wait" in rorg(robot, "request", "arm", "--rollback", code=2).stderr


def test_a_rollback_brings_back_what_the_request_replaced(robot):  # noqa: F811
    rorg(robot, "request", "arm", "--id", "tour", "--reason", "a visitor", "--wait")
    said = rorg(robot, "request", "arm", "missing", "--id", "tour", "--wait", "--rollback", code=4).stderr
    assert said.splitlines()[-1] == "request 'tour' is as it was before"
    assert requests(robot) == {"tour": ["arm"]}
    assert robot.client().requests()[0]["reason"] == "a visitor"


@pytest.mark.parametrize("rollback", [True, False])
def test_an_interrupt_says_what_becomes_of_the_request(robot, rollback):  # noqa: F811
    process = begin(robot, "request", "nav", "--wait", *(["--rollback"] if rollback else []))
    robot.wait(lambda: "nav" in requests(robot) and "slow" in robot.active())
    robot.wait(lambda: robot.loop.questions)
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=30)
    assert process.returncode == 130
    assert said == "request 'nav' " + ("is withdrawn\n" if rollback else "stays; `rorg release nav` withdraws it\n")
    assert requests(robot) == ({} if rollback else {"nav": ["nav"]})


# -- progress --------------------------------------------------------------------------------------------------------


def test_a_terminal_shows_who_waits_for_whom_and_is_left_clean(robot, ready):  # noqa: F811
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


def test_progress_is_for_terminals_alone(robot, ready):  # noqa: F811
    process = begin(robot, "request", "nav", "--wait")
    robot.wait(lambda: "slow" in robot.active() and robot.loop.questions)
    assert wait_for(
        lambda: any("slow is not ready" in r for why in robot.loop.decision.plan.reasons().values() for r in why)
    )
    ready.touch()
    out, said = process.communicate(timeout=30)
    assert (process.returncode, out, said) == (0, "request 'nav' of developer: nav\n", "")


@pytest.mark.slow
def test_a_wait_goes_on_over_the_socket_of_an_rorg_that_was_killed(tmp_path):
    """While the next one has the state directory, and takes three seconds to serve, as on a busy machine."""
    alpha = RorgProcess(tmp_path, {"alpha": {"always_on": True}})
    words = [sys.executable, "-m", "rorg", "wait", "alpha", "--state-dir", str(alpha.state)]
    try:
        for slow in (False, True):
            process = alpha.start(env=dict(os.environ)).process
            if slow:
                wait_for(lambda pid=process.pid: (StateDir(alpha.state).owner() or {}).get("pid") == pid)
                process.send_signal(signal.SIGSTOP)
                threading.Timer(3.0, process.send_signal, [signal.SIGCONT]).start()
            done = subprocess.run(words, capture_output=True, text=True, timeout=60)
            assert done.returncode == 0, done.stderr
            alpha.stop(kill=True)
    finally:
        alpha.close()
