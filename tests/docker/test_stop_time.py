"""How long a stop takes, and what rorg shows meanwhile."""

from __future__ import annotations

import signal

import pytest
from common import wait_for

from rorg.engines.protocol import stop_sequence
from rorg.history.journal import Filter

GRACE = 3.0
DEAF = """
import signal, time
def say(number, _): print(number, time.monotonic(), flush=True)
for number in (signal.SIGINT, signal.SIGTERM): signal.signal(number, say)
print("ready", flush=True)
while True: signal.pause()
"""
"""Ends by SIGKILL only, and prints what it receives before that, and when."""


def shown(robot) -> dict:
    """The service as rorg shows it; nothing before the first pass."""
    return robot.status().get("services", {}).get("arm", {"state": "", "health": ""})


@pytest.mark.slow
def test_the_grace_period_is_all_that_a_deaf_program_gets_and_it_shows_as_stopping(real_robot):
    container = {"stop_signal": "SIGINT", "stop_grace_period": f"{GRACE:g}s"}
    arm = {"command": ["python3", "-S", "-c", DEAF], "container": container, "idle": {"action": "stop"}}
    real_robot.declare({"arm": {**arm, "ready": {"log": "ready"}}})
    real_robot.request("arm")
    real_robot.wait(lambda: shown(real_robot)["health"] == "Healthy")
    made = real_robot.container("arm").id
    real_robot.release()
    wait_for(lambda: shown(real_robot)["state"] == "stopping", GRACE)
    assert real_robot.container("arm").state == "running"
    real_robot.wait(lambda: shown(real_robot)["state"] == "exited")
    done = real_robot.loop.recorder.journal.select(Filter(kinds=frozenset({"done"})), 999)
    took = next(entry["seconds"] for entry in reversed(done) if entry["verb"] == "stop")
    assert GRACE <= took < GRACE + 1
    said = b"".join(line.text for line in real_robot.engine.log_lines(made, None, None, False)).decode().split()[1:]
    received = dict(zip(map(int, said[::2]), map(float, said[1::2]), strict=True))
    assert 0.7 * GRACE < received[signal.SIGTERM] - received[signal.SIGINT] < GRACE, "SIGTERM comes within it"


@pytest.mark.parametrize("first", ["SIGINT", "SIGTERM"])
@pytest.mark.parametrize("grace", [0.0, 0.5, 5.0, 600.0])
def test_sigkill_comes_when_the_grace_period_is_over_whatever_the_first_signal(first, grace):
    steps = stop_sequence(first, grace)
    assert [step for step, _ in steps] == [*dict.fromkeys((first, "SIGTERM")), "SIGKILL"]
    assert steps[-2][1] == grace
    assert [until for _, until in steps] == sorted(until for _, until in steps)
