"""Measures the programs of docs/evaluation/programs/robot, and writes programs.json: `make programs`, as root, on a
machine that does nothing else. Takes ten minutes, and the first time some more to make the images.

rorg runs the robot on a private Docker engine. Each round measures CPU and memory of all programs, first while nobody
uses any of them and then while a visitor uses those of one state; then how long each takes to resume, to stop and to
start, one after the other.

`programs.py [--anyway] [--save FILE]`; with --anyway it measures on a busy machine too, and marks the result.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from graphlib import TopologicalSorter
from pathlib import Path
from statistics import median
from typing import Any

import programmed
from programmed import HERE, IMAGE

sys.path.extend(str(HERE.parents[1] / name) for name in ("tests/support", "images/rorg"))

import docker
from debian_images import bring, bring_ros2
from dockerd import Dockerd

from rorg.core.observed import Container
from rorg.daemon.tree import Tree
from rorg.history.durations import learned_workload
from rorg.history.journal import ALL, Filter
from rorg.host.cgroups import ROOT as CGROUPS
from rorg.host.cgroups import container_usage
from rorg.host.load import machine
from rorg.model.catalog import Catalog, Request
from rorg.tools.sim.throwaway import ThrowawayRobot
from rorg.tools.sim.validity import Conditions, flaws

ROUNDS = 3
SETTLE, WINDOW = 8.0, 20.0
"""Seconds that the programs get to settle, and then are measured for."""
IDLE = "idle"
"""The window in which nobody uses anything."""
PREFIX = "rorg-programs-"


def quiet(_: str) -> None:
    """Discards a message."""


class Robot(ThrowawayRobot):
    """The robot of real programs, of which nothing runs unless it is requested here. `action`: its programs' idle
    action."""

    def __init__(self) -> None:
        super().__init__("docker", PREFIX)
        self.action = "stop"
        # A copy, to change while it runs: the engine mounts the nodes from it.
        shutil.copytree(programmed.ROBOT, self.folder / "tree")
        self.tree = Tree(
            self.folder / "tree", str(self.state.run), references=self.references, adapt=self.under_our_control
        )
        services = programmed.robot().services
        self.names = tuple(TopologicalSorter({n: services[n].needs for n in programmed.programs()}).static_order())
        """Each program comes after those that it needs."""

    def under_our_control(self, catalog: Catalog) -> Catalog:
        services = {
            name: replace(s, always_on=False, idle=replace(s.idle, action=self.action, linger=0.0))
            for name, s in catalog.services.items()
        }
        return replace(catalog, services=services, requests=())

    def idle_by(self, action: str) -> None:
        """Changes the idle action of all programs while they run."""
        self.action = action
        (self.folder / "tree/requests/base.yaml").touch()
        self.wait(action, lambda _: all(s.idle.action == action for s in self.tree.desired.catalog.services.values()))

    def start(self) -> None:
        """Starts or resumes all programs, one after the other."""
        for name in self.names:
            self.start_one(name)

    def start_one(self, name: str) -> None:
        self.requests.change(lambda asked: asked.put(Request(name, "developer", (name,))))
        self.wait(name, lambda view: is_ready(view, name))

    def cease(self) -> None:
        self.requests.change(lambda asked: asked.without({("developer", name) for name in self.names}))
        self.wait("the end", lambda v: all(s["state"] != "running" for s in v["services"].values()))

    def times(self, since: int) -> dict[str, Any]:
        """Seconds of engine calls by verb, and of starts, resumes and stops by program, as `rorg fit` learns them.
        `since`: the journal's entry before the first of them."""
        entries = self.loop.recorder.journal.select(Filter(after=since), ALL) if self.loop else []
        learned = learned_workload("round", entries)
        services = {
            name: {what: rounded(spread.values) for what in programmed.TIMES if (spread := getattr(one, what))}
            for name, one in learned.services.items()
        }
        return {"calls": {v: rounded(spread.values) for v, spread in learned.calls.items()}, "services": services}


def is_ready(view: Mapping[str, Any], name: str) -> bool:
    service = view["services"].get(name, {})
    return bool(service.get("state") == "running" and service.get("health") == "Healthy")


def rounded(values: tuple[float, ...]) -> list[float]:
    return [round(v, 4) for v in values]


def mapped_files(container: str) -> int:
    """Bytes of files (programs, libraries, data) that the processes of a container have mapped; each page divided by
    the number of processes that share it."""
    places = (CGROUPS / folder / container / "cgroup.procs" for folder in ("memory/docker", "docker"))
    kib = 0
    for pid in next((place.read_text().split() for place in places if place.exists()), []):
        with suppress(OSError):  # it has ended
            rows = (line.split() for line in Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines())
            kib += sum(int(row[1]) for row in rows if row[0] in ("Pss_File:", "Pss_Shmem:"))
    return kib * 1024


@contextmanager
def visitor(state: str, host: str) -> Iterator[tuple[int, dict[str, int]]]:
    """A visitor's process, and what it has heard of the programs by topic, which is known in the end."""
    heard = dict[str, int]()
    volumes = [f"{programmed.ROBOT}/nodes:/nodes:ro"]
    with closing(docker.DockerClient(host, version="auto")) as client:
        words = ["python3", "/nodes/visitor.py", state]
        environment = {"PYTHONUNBUFFERED": "1", "ROS_HOSTNAME": "localhost"}
        container = client.containers.run(
            IMAGE, words, detach=True, init=True, network_mode="host", volumes=volumes, environment=environment
        )
        try:
            container.reload()
            yield container.attrs["State"]["Pid"], heard
            container.kill("SIGINT")
            container.wait(timeout=30)
            heard |= json.loads(container.logs(stderr=False).splitlines()[-1])
        finally:
            container.remove(force=True)


def window(robot: Robot, state: str, host: str) -> dict[str, Any]:
    """CPU (cores), memory and mapped files (bytes) of all programs in one window, and the conditions."""
    if state == IDLE:
        return {**measured(robot, None), "heard": {}}
    with visitor(state, host) as (pid, heard):
        found = measured(robot, pid)
    return {**found, "heard": heard}


def measured(robot: Robot, visitor: int | None) -> dict[str, Any]:
    time.sleep(SETTLE)
    runs, before, (busy, others, began) = robot.containers(), robot.usage(), _machine(visitor)
    time.sleep(WINDOW)
    after, (busy_now, others_now, now) = robot.usage(), _machine(visitor)
    _check_alive(runs, robot.containers())
    files = {c.service: mapped_files(c.id) for c in robot.containers()}
    seconds = now - began
    services = {
        name: {
            "cpu": round((after[name].cpu - before[name].cpu) / seconds, 5),
            "memory": after[name].memory,
            "files": files[name],
        }
        for name in robot.names
    }
    used = (busy_now - busy) / seconds
    other = used - (others_now - others) / seconds - sum(s["cpu"] for s in services.values())
    return {"used": round(used, 3), "other": round(max(0.0, other), 3), "services": services}


def _check_alive(before: Iterable[Container], now: Iterable[Container]) -> None:
    """Ends the measurement if a program has ended meanwhile."""
    runs = {c.incarnation for c in before if c.alive}
    ended = [f"{c.service} (exit code {c.exit_code})" for c in now if not (c.alive and c.incarnation in runs)]
    if ended:
        sys.exit(f"programs.py: cannot measure: ended meanwhile: {', '.join(ended)}; try it again")


def _machine(visitor: int | None) -> tuple[float, float, float]:
    """CPU seconds of the whole machine, those of this process and the visitor, and the time."""
    use = container_usage(visitor) if visitor else None
    return machine()["cpu_seconds"], time.process_time() + (use[0] if use else 0.0), time.monotonic()


def problems(state: str, found: Mapping[str, Any]) -> list[str]:
    """Why a window is not valid."""
    cores = os.cpu_count() or 1
    why = [flaw.why for flaw in flaws(Conditions(cores, found["other"], {}), ())]
    why += [f"nothing came of {topic}" for topic, number in found["heard"].items() if not number]
    return [f"{state}: {one}" for one in why]


def rounds(host: str, say: Callable[[str], None]) -> Generator[dict[str, Any], None, None]:
    """Measures one round after the other."""
    robot = Robot()
    try:
        loop = robot.run(robot.tree, quiet, "programs.py")
        robot.wait("the start", lambda v: len(v["services"]) > len(robot.names))
        robot.start()
        for number in range(1, ROUNDS + 1):
            windows = {}
            for state in (IDLE, *programmed.WINDOWS):
                say(f"round {number} of {ROUNDS}: {state}")
                windows[state] = window(robot, state, host)
            since = loop.recorder.journal.last
            for action in ("pause", "stop"):
                say(f"round {number} of {ROUNDS}: {action}, and back")
                robot.idle_by(action)
                robot.cease()
                robot.start()
            times = robot.times(since)
            wrong = [why for state, found in windows.items() for why in problems(state, found)]
            yield {"invalid": wrong, "windows": windows, "times": times}
    finally:
        robot.clean_up(say)


@contextmanager
def engine() -> Iterator[str]:
    """The address of a private engine that has the images."""
    os.environ["PATH"] += os.pathsep + "/usr/sbin"
    if why := Dockerd.missing():
        sys.exit(f"programs.py: cannot measure: {why}; try it as root, with docker.io installed")
    daemon = Dockerd(Path(tempfile.mkdtemp(prefix="rorg-dockerd.")))
    try:
        daemon.start()
        bring(daemon.host, HERE / "programs/image", IMAGE)
        bring_ros2(daemon.host)
        os.environ["DOCKER_HOST"] = daemon.host
        yield daemon.host
    finally:
        daemon.close()


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--anyway", action="store_true", help="measure on a busy machine, and mark the result")
    parser.add_argument("--save", type=Path, default=programmed.FILE)
    options = parser.parse_args()

    def say(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    found = list[dict[str, Any]]()
    now = machine()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # so that nothing is left behind
    with engine() as host, closing(rounds(host, say)) as results:
        for one in results:
            if one["invalid"] and not options.anyway:
                sys.exit(f"programs.py: cannot report this round: {'; '.join(one['invalid'])}")
            found.append(one)
            about = {"cores": now["cores"], "memory": now["memory_total"], "seconds": WINDOW}
            options.save.write_text(json.dumps({**about, "rounds": found}, indent=1) + "\n", encoding="utf-8")
            others = (w["other"] for w in one["windows"].values())
            say(f"other programs: {median(others):.2f} cores, median; {'; '.join(one['invalid']) or 'valid'}")


if __name__ == "__main__":
    main()
