"""Probes of every kind that hang or never stop, all at once: the robot goes on beside them, and ends when told to."""

from __future__ import annotations

import itertools
import signal
import time
from pathlib import Path

import psutil
import pytest
from common import free_port, wait_for
from hosts import HTTP, XML, Host
from robots import Daemon, write_tree

from rorg.client import Client
from rorg.core.schedule import Target
from rorg.model.probe import Probe
from rorg.probes.answer import YES, no
from rorg.probes.prober import MOST, SHARE, WORKERS, Prober

MEMORY = 150 << 20
"""Bytes that rorg has at the most."""
SLEEP = "import time; time.sleep({})"
FLOOD = "import os\nwhile True: os.write(1, bytes(1 << 16))"
TALK = "import os, signal\nfor _ in range(300): os.write(1, b'x' * (1 << 20))\nsignal.pause()"
HANGING = 9
"""Commands that hang; more than attempts at once."""


def python(code: str) -> list[str]:
    return ["python3", "-S", "-c", code]


@pytest.fixture
def hosts():
    found = {
        name: Host(say) for name, say in {**HTTP, **XML}.items() if name in ("silent", "drip", "continue", "values")
    }
    yield found
    for host in found.values():
        host.close()


@pytest.fixture
def daemon(real_robot):
    found = Daemon(real_robot)
    yield found
    found.end()


def hostile(hosts, number: int) -> dict[str, dict]:
    """Services by name. `number` is how long the commands of the probes sleep, by which they are known."""
    ready = {
        **{f"sleep{n}": {"exec": python(SLEEP.format(number)), "interval": "50ms"} for n in range(HANGING)},
        "flood": {"exec": python(FLOOD)},
        **{name: {"http": host.url} for name, host in hosts.items() if name != "values"},
        "talker": {"log": "^serving$"},
    }
    found = {name: {"always_on": True, "ready": probe} for name, probe in ready.items()}
    for name, uri in {"graph": hosts["values"].url, "node": hosts["drip"].url}.items():
        kind = "ros_topic" if name == "graph" else "ros_node"
        found[name] = {
            "always_on": True,
            "ready": {kind: "/x"},
            "container": {"environment": {"ROS_MASTER_URI": uri}},
        }
    found["talker"]["command"] = python(TALK)
    return found


def most_memory(pid: int) -> int:
    """Bytes that a process ever had (VmHWM)."""
    (line,) = [x for x in Path(f"/proc/{pid}/status").read_text().splitlines() if x.startswith("VmHWM")]
    return int(line.split()[1]) << 10


def sleeping(number: int) -> list[int]:
    return [p.pid for p in psutil.process_iter(["cmdline"]) if SLEEP.format(number) in (p.info["cmdline"] or [])]


@pytest.mark.slow
def test_what_hangs_holds_up_nobody_else(daemon, hosts):
    robot, number = daemon.robot, 100000 + free_port()
    friend = {"ready": {"exec": python("pass"), "interval": "100ms"}}
    wanted = hostile(hosts, number)
    write_tree(robot.tree, {**wanted, "friend": friend, "other": {**friend, "needs": ["friend"]}})
    daemon.start()
    wait_for(lambda: set(wanted) <= robot.active(), 120)
    wait_for(lambda: len(sleeping(number)) >= HANGING)
    client, pid = Client(robot.socket()), daemon.process.pid
    for name in ("friend", "other"):
        with client.request(name, wait=30):
            assert name in robot.active()
    assert client.status()["services"]["sleep0"]["health"] != "Healthy"
    assert most_memory(pid) < MEMORY
    began = time.monotonic()
    daemon.process.send_signal(signal.SIGTERM)
    assert daemon.process.wait(30) == 0
    assert time.monotonic() - began < 5
    assert not sleeping(number), "what the probes began is ended with them"
    write_tree(robot.tree, {name: {**spec, "ready": {"exec": python("pass")}} for name, spec in wanted.items()})
    daemon.start()
    healthy = {name: "Healthy" for name in wanted}
    wait_for(
        lambda: {n: s["health"] for n, s in daemon.status().get("services", {}).items() if n in wanted} == healthy, 120
    )


def test_only_as_many_hang_as_there_may_be(monkeypatch):
    """Of those that wait, whoever waits longest is next."""
    monkeypatch.setattr("rorg.probes.prober.SLOW", 0.2)
    hung, asked = set(), []

    def ask(key, target):
        asked.append(key)
        if target.probe.target == "hang":
            hung.add(key)
            prober._stopping.wait(60)
            return no("it hung")
        return YES

    prober = Prober(time.monotonic, lambda: None, ask)
    prober.start()
    slow = {(f"s{n}", "ready"): Target(Probe("exec", "hang"), "run", 0.01) for n in range(2 * WORKERS)}
    quick = {(f"q{n}", "ready"): Target(Probe("exec", "quick"), "run", 0.01) for n in range(3 * WORKERS)}
    prober.watch({**slow, **quick})
    wait_for(lambda: hung == set(slow) and set(asked) == {*slow, *quick}, what="all to be asked beside what hangs")
    before = len(asked)
    wait_for(lambda: set(asked[before:]) == set(quick), what="all others to be asked again")
    prober.watch({(f"s{n}", "ready"): Target(Probe("exec", "hang"), "run", 0.01) for n in range(2 * MOST)})
    wait_for(lambda: len(hung) == MOST, 60)
    began = time.monotonic()
    prober.stop()
    prober.join(10)
    assert time.monotonic() - began < 3
    assert prober.hung == 0
    assert len(hung) == MOST


def test_who_makes_a_probe_work_is_asked_the_less_often():
    begun = []

    def ask(key, target):
        begun.append(time.monotonic())
        until = time.thread_time() + 0.01
        while time.thread_time() < until:
            pass
        return YES

    prober = Prober(time.monotonic, lambda: None, ask)
    prober.start()
    prober.watch({("busy", "ready"): Target(Probe("tcp", "x"), "run", 0.01)})
    wait_for(lambda: len(begun) > 3)
    prober.stop()
    assert all(after - before >= 0.01 / SHARE for before, after in itertools.pairwise(begun))


def test_an_engine_that_hangs_keeps_nobody_from_ending(docker_robot, dockerd):
    """Its calls and its probes cannot be ended; nobody waits for them."""
    if dockerd.process is None:
        pytest.skip("the engine is somebody else's")
    daemon = Daemon(docker_robot)
    probe = {"exec": python("pass"), "interval": "50ms"}
    services = {f"cam{n}": {"ready": {**probe, "failures": 1}} for n in range(2)}
    late = [f"late{n}" for n in range(5)]
    write_tree(docker_robot.tree, {**services, **{name: {} for name in late}})
    daemon.start()
    wait_for(daemon.settled, 60)
    docker_robot.request(*services)
    wait_for(lambda: set(services) <= docker_robot.active(), 60)

    def calls(name: str) -> bool:
        return name in str(daemon.status()["in_flight"])

    try:
        for name in late:  # on a busy machine rorg may know that the engine hangs before it calls it
            dockerd.process.send_signal(signal.SIGSTOP)
            docker_robot.request(name, id=name)
            wait_for(lambda name=name: calls(name) or not daemon.status()["engine"]["complete"], 60)
            if calls(name):
                break
            dockerd.process.send_signal(signal.SIGCONT)
            wait_for(lambda name=name: name in docker_robot.active(), 60)
        began = time.monotonic()
        daemon.process.send_signal(signal.SIGTERM)
        assert daemon.process.wait(60) == 0
        assert time.monotonic() - began < 5
    finally:
        dockerd.process.send_signal(signal.SIGCONT)
    assert "unfinished call" in (docker_robot.state.path.parent / "run.log").read_text()
    daemon.start()
    wait_for(lambda: name in docker_robot.active(), 60)
