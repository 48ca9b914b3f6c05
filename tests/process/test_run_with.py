"""`rorg run-with`: services are requested for as long as a command runs, and its end is the command's."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys

import pytest
from thin_commands import rorg
from waiting_commands import begin, read, ready, requests, robot  # noqa: F401


def test_services_are_requested_as_long_as_the_command_runs(robot, tmp_path):  # noqa: F811
    running = begin(robot, "run-with", "arm", "--", "sh", "-c", 'echo "$1"; read line; exit 7', "-", "--wait", stdin=-1)
    assert running.stdout.readline() == "--wait\n"
    assert "arm" in robot.active()
    (request,) = (r for r in robot.client().requests() if not r["standing"])
    assert request["services"] == ["arm"]
    assert request["reason"] == "runs sh"
    assert request["ttl"] > 0
    running.communicate("\n", timeout=30)
    assert running.returncode == 7
    assert requests(robot) == {}


@pytest.mark.slow
def test_the_lease_is_renewed(robot):  # noqa: F811
    code = "from rorg_client import Client; Client.request.__kwdefaults__['ttl'] = 1.0; "
    code += "from rorg.cli.main import run; run()"
    running = subprocess.Popen(
        [sys.executable, "-c", code, "run-with", "arm", "--", "sh", "-c", "echo begun; read line"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "RORG_STATE_DIR": str(robot.state.path)},
    )
    assert running.stdout.readline() == "begun\n"
    (request,) = (r for r in robot.client().requests() if not r["standing"])
    until = robot.loop.clock() + 2.5
    robot.wait(lambda: robot.loop.clock() > until)
    assert request["id"] in requests(robot)
    running.kill()
    robot.wait(lambda: requests(robot) == {})  # and so it ends with the program, however that ends
    running.communicate()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signals_go_to_the_command(robot, number):  # noqa: F811
    script = "trap 'echo INT; exit 5' INT; trap 'echo TERM; exit 6' TERM; echo begun; while :; do sleep 0.05; done"
    running = begin(robot, "run-with", "arm", "--", "sh", "-c", script, start_new_session=True)
    assert running.stdout.readline() == "begun\n"
    running.send_signal(number)
    out, _ = running.communicate(timeout=30)
    assert (out, running.returncode) == {2: ("INT\n", 5), 15: ("TERM\n", 6)}[number]
    assert requests(robot) == {}


def test_a_command_that_a_signal_ends(robot):  # noqa: F811
    rorg(robot, "run-with", "arm", "--", "sh", "-c", "kill -9 $$", code=137)
    assert requests(robot) == {}


def test_what_is_typed_at_a_terminal_reaches_the_command_once(robot):  # noqa: F811
    script = "trap 'echo got' INT; echo begun; read line; read line; echo over"
    words = [sys.executable, "-m", "rorg", "run-with", "arm", "--", "bash", "-c", script]
    pid, main = pty.fork()
    if pid == 0:
        os.environ["RORG_STATE_DIR"] = str(robot.state.path)
        os.execv(words[0], words)
    assert "begun" in read(main, "begun")
    os.write(main, b"\x03")
    said = read(main, "got")
    os.write(main, b"\n\n")
    said += read(main, "over")
    assert said.count("got") == 1, said
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
    os.close(main)
    assert requests(robot) == {}


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_before_the_command_begins_ends_the_request(robot, number, code):  # noqa: F811
    running = begin(robot, "run-with", "nav", "--", "echo", "begun")
    robot.wait(lambda: robot.loop.questions)
    running.send_signal(number)
    out, _ = running.communicate(timeout=30)
    assert (out, running.returncode) == ("", code)
    assert requests(robot) == {}


def test_a_command_waits_until_all_is_ready_or_does_not(robot, ready):  # noqa: F811
    rorg(robot, "run-with", "nav", "--no-wait", "--", "test", "!", "-e", str(ready))
    said = rorg(robot, "run-with", "nav", "--timeout", "0.5", "--", "echo", "begun", code=4)
    assert said.stdout == ""
    assert "slow" in said.stderr
    assert requests(robot) == {}
    running = begin(robot, "run-with", "nav", "--", "test", "-e", str(ready))
    robot.wait(lambda: robot.loop.questions)
    ready.touch()
    assert running.wait(30) == 0
    running.communicate()


def test_wrong_lines_request_nothing(robot):  # noqa: F811
    assert "no such program" in rorg(robot, "run-with", "arm", "--", "no-such-program", code=2).stderr
    assert "missing argument 'PROGRAM' after --" in rorg(robot, "run-with", "arm", "sh", code=2).stderr
    assert "nope" in rorg(robot, "run-with", "nope", "--", "true", code=2).stderr
    assert requests(robot) == {}
    robot.stop()
    assert "rorg run" in rorg(robot, "run-with", "arm", "--", "true", code=3).stderr
