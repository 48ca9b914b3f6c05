"""An rorg that is stopped, killed or replaced while programs wait: they see no more than a longer wait."""

from __future__ import annotations

import threading

import pytest
from common import wait_for
from robots import Daemon, write_tree

from rorg.client import Client

SLOW_END = (
    "import signal, time\nsignal.signal(signal.SIGINT, lambda *_: (time.sleep(2), exit()))\n"
    "print('up', flush=True)\nwhile True: signal.pause()"
)


@pytest.fixture
def daemon(real_robot):
    found = Daemon(real_robot)
    yield found
    found.kill()


def begin(daemon: Daemon, services: dict) -> Client:
    write_tree(daemon.robot.tree, {"always": {"always_on": True}, **services})
    daemon.start()
    wait_for(daemon.settled, 60)
    return Client(daemon.robot.socket())


@pytest.mark.slow
def test_who_waits_through_a_stop_gets_what_was_asked_for(daemon, tmp_path):
    mark = tmp_path / "ready" if daemon.robot.kind == "process" else "/ready"
    client = begin(
        daemon,
        {
            "cam": {
                "ready": {
                    "interval": "50ms",
                    "exec": ["python3", "-c", f"import os, sys; sys.exit(not os.path.exists('{mark}'))"],
                }
            }
        },
    )
    held: list[str] = []
    errors: list[BaseException] = []

    def program() -> None:
        try:
            with Client(daemon.robot.socket()).request("cam", wait=60):
                held.append(daemon.robot.container("cam").state)
        except BaseException as error:
            errors.append(error)

    programs = [threading.Thread(target=program) for _ in range(3)]
    for thread in programs:
        thread.start()
    wait_for(lambda: len(client.requests()) == 3 and "cam" in daemon.robot.active())
    daemon.stop()
    daemon.start()
    wait_for(daemon.settled_but_waiting, 60)
    daemon.robot.engine.exec(daemon.robot.container("cam").id, ["python3", "-c", f"open('{mark}', 'w')"], 10)
    for thread in programs:
        thread.join(60)
    assert not errors
    assert held == ["running"] * 3
    wait_for(lambda: "cam" not in daemon.robot.active())


@pytest.mark.slow
def test_what_an_rorg_was_ending_when_it_was_killed_is_not_ready_for_the_next(daemon):
    client = begin(
        daemon,
        {
            "slow": {
                "command": ["python3", "-c", SLOW_END],
                "container": {"stop_signal": "SIGINT", "stop_grace_period": "4s"},
                "idle": {"action": "stop", "linger": 0},
                "ready": {"log": "up"},
            }
        },
    )
    client.request("slow", id="a", wait=30, ttl=None)
    first = daemon.robot.container("slow").incarnation
    client.release("a")
    wait_for(lambda: daemon.status().get("in_flight") == {"slow": "stop"})
    daemon.kill()
    daemon.start()
    client.request("slow", id="b", wait=60, ttl=None)
    now = daemon.robot.container("slow")
    assert now.state == "running"
    assert now.incarnation != first
    client.release("b")
