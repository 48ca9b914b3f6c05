"""A robot of three computers: three Docker engines and three rorgs, each in a network of its own. What ran where is
read from the engines' own events. `make machines` runs it."""

from __future__ import annotations

import itertools
import os
import shutil
import signal
import statistics
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import docker
import psutil
import pytest
from common import wait_for
from computers import LEASE, Computer, Team
from dockerd import Dockerd, import_base
from links.network import Network, processes_of

NAMES = ("base", "head", "arm")
SERVICES = {
    "tour": {"machine": "base", "needs": ["navigation"]},
    "navigation": {"machine": "base", "needs": ["localization"]},
    "localization": {"machine": "head", "needs": ["camera"]},
    "camera": {"machine": "head"},
    "speech": {"machine": "head", "needs": ["microphone"]},
    "microphone": {"machine": "arm"},
    "grasp": {"machine": "arm", "needs": ["gripper", "localization"]},
    "gripper": {"machine": "arm"},
}
CUT = 30.0
"""Seconds of a cut."""


class Engine(Dockerd):
    """A Docker engine on one of the computers, and what it says of its containers."""

    def __init__(self, folder: Path, name: str, network: Network) -> None:
        super().__init__(folder)
        self.name, self.network = name, network
        self.options = ("--cgroup-parent", f"/rorg-{os.getpid()}-{name}")
        self.seen: list[tuple[float, str, str]] = []
        """(when, service, start or die)."""

    def as_user(self) -> list[str]:
        return [*self.network.enter(self.name)]

    def start(self) -> None:
        super().start()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        try:
            events = docker.APIClient(self.host, version="auto", timeout=600).events(
                decode=True, filters={"type": "container", "event": ["start", "die"]}
            )
            for event in events:
                service = event["Actor"]["Attributes"].get("rorg.io/service", "")
                self.seen.append((event["timeNano"] / 1e9, service, event["Action"]))
        except Exception:
            return  # the engine has ended

    def spans(self, service: str) -> list[tuple[float, float]]:
        """From when until when a service ran; the last one may go on."""
        found, began = [], 0.0
        for at, name, what in self.seen:
            if name == service and what == "start":
                began = at
            elif name == service and began:
                found.append((began, at))
                began = 0.0
        return [*found, *([(began, float("inf"))] if began else [])]


class Robot:
    def __init__(self, folder: Path) -> None:
        self.network = Network(NAMES)
        self.engines: dict[str, Engine] = {}
        for name in NAMES:
            (folder / f"engine-{name}").mkdir()
            self.engines[name] = Engine(folder / f"engine-{name}", name, self.network)
            self.engines[name].start()
            import_base(self.engines[name].host)
        self.team = Team(folder, SERVICES, NAMES, "docker", self._computer)

    def _computer(self, folder: Path, name: str) -> Computer:
        address, enter = f"{self.network.addresses[name]}:7878", self.network.enter(name)
        return Computer(folder, name, address, "docker", self.engines[name].host, enter)

    def __getitem__(self, name: str) -> Computer:
        return self.team.computers[name]

    def running(self) -> set[str]:
        """What runs, by the engines."""
        found = set()
        for engine in self.engines.values():
            for container in docker.APIClient(engine.host, version="auto").containers():
                found.add(container["Labels"]["rorg.io/service"])
        return found

    def check(self) -> None:
        """By the engines: no service ran on two computers at once, and each on its own unless it was moved."""
        for service, spec in SERVICES.items():
            spans = sorted(span for engine in self.engines.values() for span in engine.spans(service))
            assert all(one[1] <= other[0] for one, other in itertools.pairwise(spans)), (service, spans)
            ran = {name for name, engine in self.engines.items() if engine.spans(service)}
            assert ran <= {spec["machine"], *(("arm",) if service == "navigation" else ())}, (service, ran)
        for computer in self.team.computers.values():
            assert "bug:" not in computer.log.read_text()
            assert "internal error" not in computer.log.read_text()

    def close(self) -> None:
        self.network.heal()
        self.team.stop()
        for engine in self.engines.values():
            engine.close()
        self.network.close()


@pytest.fixture(scope="module")
def robot() -> Iterator[Robot]:
    folder = Path(tempfile.mkdtemp(prefix="rorg-dockerd."))
    made = Robot(folder)
    made.team.start()
    yield made
    made.close()
    shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(autouse=True)
def quiet(robot) -> Iterator[None]:
    """Each test begins and ends with whole links and nothing requested."""
    yield
    robot.network.heal()
    for computer in robot.team.computers.values():
        for request in computer.client.requests():
            if not request["standing"] and "@" not in request["id"]:
                computer.client.release(request["id"])
    wait_for(lambda: robot.running() == set(), 60, "everything to be idle")
    robot.check()


def test_the_tour_runs_over_all_three(robot):
    base = robot["base"]
    for names, active in (
        (("tour",), {"tour", "navigation", "localization", "camera"}),
        (("speech",), {"speech", "microphone"}),
        (("grasp",), {"grasp", "gripper", "localization", "camera"}),
        (("tour", "speech"), {"tour", "navigation", "localization", "camera", "speech", "microphone"}),
    ):
        base.ask("leg", *names)
        base.wait(*names)
        wait_for(lambda: robot.running() == active, 30, f"only {active} to run")  # noqa: B023
    chain = [link["text"] for link in robot["arm"].why("microphone")["chain"]]
    assert chain == [
        "microphone@arm (needed by speech)",
        "speech@head (requested by developer (leg@base))",
        "developer (meta-service)",
    ]


def seconds(request: Computer, service: str, times: int = 10) -> float:
    """Median time from a request to ready, of a stopped service."""
    took = []
    for number in range(times):
        began = time.monotonic()
        request.ask(f"time{number}", service)
        request.wait(service)
        took.append(time.monotonic() - began)
        request.client.release(f"time{number}")
        owner = SERVICES[service]["machine"]
        wait_for(lambda: request.state(service) not in ("running", "unknown"), 30, f"{service}@{owner} to stop")
    return statistics.median(took)


def test_a_remote_request_takes_little_longer_than_a_local_one(robot):
    local, remote = seconds(robot["arm"], "gripper"), seconds(robot["base"], "gripper")
    print(f"machines: a request takes {local * 1000:.0f} ms on its computer, {remote * 1000:.0f} ms from another one")
    assert remote < local + 0.5


def lost_at(computer: Computer, service: str) -> float:
    from datetime import datetime

    events = [e for e in computer.events("lost") if e["service"] == service]
    return datetime.fromisoformat(events[-1]["at"]).timestamp() if events else 0.0


def stopped_at(robot: Robot, service: str) -> float:
    return max(
        (at for at, name, what in robot.engines[SERVICES[service]["machine"]].seen if (name, what) == (service, "die"))
    )


@pytest.mark.parametrize("directions", [[("base", "head"), ("head", "base")], [("base", "head")], [("head", "base")]])
def test_a_cut_link_loses_the_lease_after_its_users_know(robot, directions):
    """In both directions, and in either one: TCP needs both, so the effect is the same."""
    base, head = robot["base"], robot["head"]
    base.ask("t", "tour")
    base.wait("tour")
    tour = base.services()["tour"]["incarnation"]
    began = time.time()
    for sender, receiver in directions:
        robot.network.cut(sender, receiver)
    wait_for(lambda: "localization" not in robot.running(), 3 * LEASE, "the lease to end")
    assert base.state("localization") == "unknown"
    told, stopped = lost_at(base, "localization"), stopped_at(robot, "localization")
    print(f"machines: lost after {told - began:.1f} s, stopped after {stopped - began:.1f} s")
    assert began < told < stopped
    assert base.services()["tour"]["incarnation"] == tour, "nothing is stopped because of a link"
    left = CUT - (time.time() - began)
    assert left > 0
    # While it is cut, the head works for those that it can hear.
    robot["arm"].ask("g", "grasp")
    robot["arm"].wait("grasp")
    robot["arm"].client.release("g")
    wait_for(lambda: time.time() - began > CUT, CUT, "the cut to last")
    robot.network.heal()
    base.wait("tour", timeout=30)
    assert base.services()["tour"]["incarnation"] == tour
    assert head.ready("localization")


def test_a_lossy_network_keeps_leases(robot):
    base = robot["base"]
    base.ask("t", "tour")
    base.wait("tour")
    runs = {n: robot["head"].services()[n]["incarnation"] for n in ("localization", "camera")}
    for name in NAMES:
        robot.network.lose(name, 0.2)
    ended = time.monotonic() + 4 * LEASE
    while time.monotonic() < ended:
        assert {"tour", "navigation", "localization", "camera"} <= robot.running()
        time.sleep(0.5)
    assert {n: robot["head"].services()[n]["incarnation"] for n in runs} == runs


def test_a_frozen_computer_is_unknown_and_comes_back(robot):
    base, head = robot["base"], robot["head"]
    base.ask("t", "tour")
    base.wait("tour")
    assert head.process is not None
    frozen = [psutil.Process(head.process.pid), *processes_of(robot.engines["head"])]
    for process in frozen:
        process.suspend()
    wait_for(lambda: base.state("localization") == "unknown", 2 * LEASE, "the state to be unknown")
    ended = time.monotonic() + 2 * LEASE
    wait_for(lambda: time.monotonic() > ended, 3 * LEASE, "the freeze to last")
    assert base.state("navigation") == "running"
    for process in frozen:
        process.resume()
    base.wait("tour", timeout=60)
    assert {"tour", "navigation", "localization", "camera"} <= robot.running()


def test_a_killed_computer_comes_back(robot):
    """Its rorg, its engine and all containers die at once, and start again as after a power cut."""
    base, head, engine = robot["base"], robot["head"], robot.engines["head"]
    base.ask("t", "tour")
    base.wait("tour")
    assert head.process is not None
    for process in [psutil.Process(head.process.pid), *processes_of(engine)]:
        try:
            process.send_signal(signal.SIGKILL)
        except psutil.NoSuchProcess:
            continue
    head.process.wait(10)
    wait_for(lambda: base.state("localization") == "unknown", 2 * LEASE, "the state to be unknown")
    engine.stop(kill=True)
    engine.start()
    head.start()
    base.wait("tour", timeout=60)
    assert {"tour", "navigation", "localization", "camera"} == robot.running()


def test_a_service_moves_by_a_commit_and_back_by_its_revert(robot):
    base = robot["base"]
    base.ask("t", "tour")
    base.wait("tour")
    moved = {**SERVICES, "navigation": {**SERVICES["navigation"], "machine": "arm"}}
    for services, owner in ((moved, "arm"), (SERVICES, "base")):
        robot.team.declare(services)
        wait_for(lambda: robot[owner].services()["navigation"]["machine"] == owner, 20, "the manifest")  # noqa: B023
        wait_for(lambda: robot[owner].ready("navigation"), 60, f"navigation to run on {owner}")  # noqa: B023
        base.wait("tour", timeout=30)
        robot.check()
    assert len(robot.engines["arm"].spans("navigation")) == 1


def test_renewals_are_sent_in_time_beside_busy_loops(robot, tmp_path):
    """Two busy loops beside three robots on this machine: the worst delay of a renewal is far below a lease."""
    busy = [psutil.Popen(["python3", "-c", "while True: pass"]) for _ in range(2)]
    try:
        worst, ended = 0.0, time.monotonic() + 3 * LEASE
        while time.monotonic() < ended:
            views = [m for m in robot["base"].client.call("GET", "/v1/machines") if not m["here"]]
            worst = max([worst, *(m["since"] for m in views if m["since"] is not None)])
            time.sleep(0.2)
    finally:
        for process in busy:
            process.kill()
            process.wait()
    print(f"machines: at most {worst:.1f} s between answered renewals, of {LEASE / 3:.1f} s")
    assert worst < LEASE * 0.6
