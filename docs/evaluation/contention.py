"""Measures how responsive the tour guide is when its programs ask for more CPU than two cores have, if it is run in
five ways: everything on, the same with CPU shares, by a script with Compose, by rorg with the manifests of manifests/,
and by rorg that pauses instead of stopping and gives the foreground CPU shares. Writes contention.json.

`make contention ARGS="--rounds 5 --demand 3"`, as root, on a machine that does nothing else. It starts a Docker engine
of its own. COMPOSE names a binary of Docker Compose 2; without it the script uses `docker start` and `docker stop`.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import platform
import queue
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from statistics import mean
from typing import Any

import contended
import psutil
from common import wait_for
from contention_robot import CORES, FAVOUR, FOREGROUND, PATIENCE, START_WORK, AllOn, Robot, Rorg, Script, Stop, tour_of
from dockerd import Dockerd, clean_up, import_base
from foreground import PERIOD, RECORD
from slices import Slice

from rorg.errors import NotReady, RorgError
from rorg.host.load import machine
from rorg.tools.sim.validity import MOST_OTHER, OtherLoad

LOOK, SAMPLE, SETTLE = 0.02, 0.5, 3.0
"""Seconds: between two tries to reach a service, between two samples of memory, and of rest before a run."""
MOST_REPEATED = 3
"""Runs that may be repeated because of other programs, before the measurement is given up."""


# -- one run -----------------------------------------------------------------------------------------------------------


def answered(port: int) -> None:
    """Returns when a program has accepted a connection and closed it: the port of a paused one accepts, too."""
    while True:
        with suppress(OSError), socket.create_connection(("127.0.0.1", port), PATIENCE) as connection:
            if not connection.recv(1):
                return
        time.sleep(LOOK)


def ready(robot: Robot, names: Collection[str]) -> None:
    """Returns when all of these have answered. Raises NotReady."""
    waiting, found = {name for name in names if name not in FOREGROUND}, queue.SimpleQueue[str]()

    def wait(name: str) -> None:
        answered(robot.ports[name])
        found.put(name)

    for name in waiting:
        threading.Thread(target=wait, args=(name,), daemon=True).start()
    deadline = time.monotonic() + PATIENCE
    while waiting:
        try:
            waiting = waiting - {found.get(timeout=max(0.0, deadline - time.monotonic()))}
        except queue.Empty:
            raise NotReady("play the tour", f"{', '.join(sorted(waiting))} did not answer") from None


def guided(robot: Robot, work: float) -> None:
    """Has the guide do so many CPU seconds of work."""
    with socket.create_connection(("127.0.0.1", robot.ports["guide"]), PATIENCE) as connection:
        connection.sendall(f"{work}\n".encode())
        if connection.recv(16) != b"done\n":
            raise RuntimeError("the guide has not done its work")


class Meters:
    """What the robot and other programs use between the beginning and the end of a block."""

    def __init__(self, group: Slice) -> None:
        self.group, self.memory = group, list[float]()
        self._over = threading.Event()

    def _look(self) -> dict[str, float]:
        faults = dict(line.split() for line in Path("/proc/vmstat").read_text().splitlines())
        return {
            "at": time.monotonic(),
            "all": machine()["cpu_seconds"],
            "own": self.group.look()["cpu_seconds"],
            "engine": self.group.look("others")["cpu_seconds"],
            "steal": getattr(psutil.cpu_times(), "steal", 0.0),
            "pgfault": float(faults["pgfault"]),
            "pgmajfault": float(faults["pgmajfault"]),
        }

    def _sample(self) -> None:
        while not self._over.wait(SAMPLE):
            self.memory.append(self.group.look()["memory"])

    def __enter__(self) -> Meters:
        self.load, self.began = os.getloadavg()[0], self._look()
        self._thread = threading.Thread(target=self._sample)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        end = self._look()
        self.used = {key: end[key] - value for key, value in self.began.items()}

    def figures(self) -> dict[str, Any]:
        """Cores, bytes and numbers."""
        used, seconds = self.used, self.used["at"]
        return {
            "seconds": round(seconds, 3),
            "cpu": {"cores": round(used["own"] / seconds, 4), "engine": round(used["engine"] / seconds, 4)},
            "memory": {"mean": round(mean(self.memory)), "most": round(max(self.memory))},
            "faults": {"minor": round(used["pgfault"] - used["pgmajfault"]), "major": round(used["pgmajfault"])},
            "other": round(max(0.0, used["all"] - used["own"]) / seconds, 4),
            "steal": round(used["steal"] / seconds, 4),
            "load": self.load,
        }


def toured(robot: Robot, enter: Callable[[str], None], tour: Sequence[Stop]) -> dict[str, Any]:
    """Plays the tour. Returns how long requests took until they were ready, by state, and how long it took after the
    request for the tour until the robot moved: until the route, the first work, was planned."""
    took: dict[str, list[float]] = {}
    moves = 0.0
    for number, stop in enumerate(tour):
        asked = time.monotonic()
        if number:
            enter(stop.state)
            ready(robot, robot.closure(robot.states[stop.state]))
            took.setdefault(stop.state, []).append(round(time.monotonic() - asked, 4))
        for again in range(stop.times):
            if stop.work:
                guided(robot, stop.work)
            if stop.state == "tour" and not again:
                moves = time.monotonic() - asked
            time.sleep(stop.wait)
    return {"ready": took, "moves": round(moves, 4)}


def controlled(file: Path, began: float, seconds: float) -> dict[str, float]:
    """Figures of the control loop between two times: percent of deadlines missed, and latencies in seconds."""
    rounds = [one for one in RECORD.iter_unpack(file.read_bytes()) if began <= one[0] < began + seconds]
    late = list(contended.latencies(rounds, PERIOD))
    parts = {"p50": 0.5, "p95": 0.95, "p99": 0.99, "longest": 1.0}
    figures = {name: round(contended.percentile(late, part), 6) for name, part in parts.items()}
    return {"ticks": len(late), "missed": round(contended.missed(late, PERIOD), 3), **figures}


def measure(way: str, robot: Robot, group: Slice, host: str, tour: Sequence[Stop]) -> dict[str, Any]:
    """One run, from the start of the robot to its removal."""
    with tempfile.TemporaryDirectory(prefix="rorg-contention-") as name:
        folder = Path(name)
        ways: Mapping[str, Callable[[], AllOn | Rorg]] = {
            "all-on": lambda: AllOn(robot, folder),
            "shares": lambda: AllOn(robot, folder, FAVOUR),
            "script": lambda: Script(robot, folder),
            "rorg": lambda: Rorg(robot, folder, host),
            "rested": lambda: Rorg(robot, folder, host, FAVOUR),
        }
        one = ways[way]()
        try:
            ready(robot, one.begin())
            wait_for(lambda: (folder / "control").exists(), PATIENCE, "the control loop")
            guided(robot, 0.0)
            time.sleep(SETTLE)
            with Meters(group) as meters:
                found = toured(robot, one.enter, tour)
            control = controlled(folder / "control", meters.began["at"], meters.used["at"])
        finally:
            one.end()
    return {"way": way, **meters.figures(), **found, "control": control}


# -- all runs ----------------------------------------------------------------------------------------------------------


def runs(args: argparse.Namespace, robot: Robot, group: Slice, host: str) -> Iterator[tuple[dict[str, Any], bool]]:
    """Each run, and whether it counts. Raises SystemExit if other programs use too much of the machine too often."""
    repeated = 0
    for number in range(1, args.rounds + 1):
        for way in contended.WAYS:
            while True:
                try:
                    run = measure(way, robot, group, host, tour_of(args.seed, number, args.seconds))
                except RorgError as error:
                    sys.exit(f"rorg: {error}")
                disturbed = run["other"] > MOST_OTHER * CORES
                yield {"round": number, **run}, args.anyway or not disturbed
                if args.anyway or not disturbed:
                    break
                load, repeated = OtherLoad(run["other"], CORES), repeated + 1
                if repeated > MOST_REPEATED:
                    sys.exit(f"rorg: cannot report the measurement: {load.why}; try {load.remedy}")


def measure_all(args: argparse.Namespace, group: Slice) -> None:
    """Measures one level of demand on an engine of its own, and saves it if all runs are valid."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, ended)
    group.add(os.getpid())
    load, found, repeated = os.getloadavg()[0], list[dict[str, Any]](), 0
    robot = Robot(args.demand)
    with engine(group) as host:
        for run, counts in runs(args, robot, group, host):
            print(contended.summary(run) + ("" if counts else ": repeated"), flush=True)
            found += [run] if counts else []
            repeated += not counts
        level = {"demand": args.demand, "seed": args.seed, "waits": args.seconds, "start_work": START_WORK}
        level |= {"checked": not args.anyway, "load": load, "machine": described(group), "repeated": repeated}
    saved = json.loads(args.save.read_text()) if args.save.exists() else {"synthetic": True, "levels": {}}
    saved["levels"][f"{args.demand:g}"] = {**level, "runs": found}
    args.save.write_text(json.dumps(saved, indent=1) + "\n")


def ended(*_: object) -> None:
    """Ends this process, and removes everything first, however often a signal comes."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    sys.exit(1)


@contextmanager
def engine(group: Slice) -> Iterator[str]:
    """A Docker engine whose containers are in the group, until the end of the block. Yields its address."""
    clean_up()
    daemon = Dockerd(Path(tempfile.mkdtemp(prefix="rorg-dockerd.", dir="/tmp")))
    daemon.options = ("--cgroup-parent", group.name)
    try:
        daemon.start()
        import_base(daemon.host)
        os.environ["DOCKER_HOST"] = daemon.host
        yield daemon.host
    finally:
        daemon.close()


def described(group: Slice) -> dict[str, Any]:
    """The machine and the programs that ran the robot."""
    models = [line.split(": ")[1] for line in Path("/proc/cpuinfo").read_text().splitlines() if "model name" in line]
    compose = os.environ.get("COMPOSE")
    return {
        "cores": CORES,
        "cpu": models[0] if models else platform.machine(),
        "memory": psutil.virtual_memory().total,
        "kernel": platform.release(),
        "cgroups": 1 if group.v1 else 2,
        "docker": output_of("docker", "version", "--format", "{{.Server.Version}}"),
        "compose": f"Compose {output_of(compose, 'version', '--short')}" if compose else "docker start and stop",
        "python": platform.python_version(),
    }


def output_of(*words: str) -> str:
    return subprocess.run(words, capture_output=True, text=True, check=True).stdout.strip()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5, help="runs of each way")
    parser.add_argument("--demand", type=float, default=3.0, help="of all programs together, in machines")
    parser.add_argument("--seconds", type=float, default=30.0, help="of the tour in which nobody waits for the robot")
    parser.add_argument("--seed", type=int, default=1, help="of the waits")
    parser.add_argument("--save", type=Path, default=contended.FILE, help="file in which to replace this level")
    parser.add_argument("--anyway", action="store_true", help="also if other programs use the machine; to try it out")
    args = parser.parse_args()
    os.environ["PATH"] += os.pathsep + "/usr/sbin"
    if missing := Dockerd.missing():
        parser.error(missing)
    # A niced measurement does not get in the way of others.
    group = Slice(1024 if os.nice(0) == 0 else 300)
    # The group can only be removed by a process outside it.
    child = multiprocessing.get_context("fork").Process(target=measure_all, args=(args, group))
    try:
        child.start()
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, lambda *_: child.terminate())
        child.join()
    finally:
        group.close()
    return child.exitcode or 0


if __name__ == "__main__":
    sys.exit(main())
