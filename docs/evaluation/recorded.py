"""Runs robots on a private Docker engine with `rorg run`, records them, and simulates what was recorded: how far is the
simulator off? Writes recorded.json, from which evaluate.py makes the tables. As root, in a quarter of an hour.

`recorded.py [--anyway FILE] [NAME...]`: a machine that does something else is refused, unless the result goes to
another file. Names choose robots."""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / "tests"), str(Path(__file__).parent)]

import psutil
from dockerd import Dockerd, import_base
from recorded_robots import ROBOTS, Ask, Robot, busy_robot
from rorg_client import Client, calls

from rorg.engines.docker.engine import DockerEngine
from rorg.engines.make import make_engine
from rorg.history.database import Database
from rorg.history.journal import ALL, Filter, Journal
from rorg.host.load import machine
from rorg.manifest.load import load_or_raise
from rorg.manifest.traces import read_trace
from rorg.manifest.workloads import read_workload
from rorg.model.catalog import Catalog
from rorg.model.learned import Learned
from rorg.model.trace import Trace
from rorg.model.units import parse_time, stamp
from rorg.model.workload import Distribution, Workload
from rorg.store.state_dir import StateDir
from rorg.tools.sim.emulation import agreement
from rorg.tools.sim.meters import ServicesMeter
from rorg.tools.sim.results import Responses, RunResult, Sample
from rorg.tools.sim.simulate import simulate
from rorg.tools.sim.validity import Conditions, flaws

FILE = Path(__file__).parent / "recorded.json"
LOOK, LOOKS = 0.25, 4
"""Seconds between two looks at what services use; looks for each sample."""
PATIENCE = 60.0


@dataclass(frozen=True)
class Recorded:
    """One run, and the files that the commands of rorg made of it."""

    result: RunResult
    catalog: Catalog
    trace: Trace
    workload: Workload
    conditions: Conditions


class Running:
    """A robot that `rorg run` runs on an engine."""

    def __init__(self, folder: Path, robot: Robot, host: str) -> None:
        self.folder, self.robot, self.tree = folder, robot, robot.write(folder / "tree")
        self.state = folder / "state"
        self.environment = {**os.environ, "DOCKER_HOST": host}
        with (folder / "rorg.log").open("wb") as log:
            words = self._words("run", str(self.tree), "--engine", "docker")
            self.process = subprocess.Popen(words, stdout=log, stderr=log, env=self.environment)
        self.client = Client(str(self.state / "run/rorg.sock"), patience=PATIENCE)
        self.engine = make_engine("docker", StateDir(self.state))

    def _words(self, *words: str) -> list[str]:
        return [sys.executable, "-m", "rorg", *words, "--state-dir", str(self.state)]

    def call(self, *words: str) -> None:
        """Runs a command of rorg."""
        subprocess.run(self._words(*words), check=True, env=self.environment, stdout=subprocess.DEVNULL)

    def ask(self, one: Ask) -> None:
        """Makes or releases a request."""
        if not one.services:
            self.client.do(calls.release(one.id, one.by))
            return
        body = {"services": list(one.services), "reason": "", "priority": None, "ttl": one.ttl}
        self.client.do(calls.put_request(one.id, body, one.by))

    def journal(self) -> list[dict[str, Any]]:
        return Journal(Database(StateDir(self.state).journal)).select(Filter(), ALL)

    def cpu_seconds(self) -> float:
        """CPU seconds of rorg."""
        return sum(psutil.Process(self.process.pid).cpu_times()[:4])

    def close(self) -> None:
        self.process.send_signal(signal.SIGTERM)
        self.process.wait(PATIENCE)
        for container in self.engine.list():
            if container.alive:
                self.engine.stop(container.id, "SIGKILL", 5.0)
            self.engine.remove(container.id)


def record(robot: Robot, host: str) -> Recorded:
    """Runs a robot for its day."""
    with tempfile.TemporaryDirectory(prefix="rorg-recorded-") as folder:
        running = Running(Path(folder), robot, host)
        try:
            return _recorded(running)
        finally:
            running.close()


def _recorded(running: Running) -> Recorded:
    began = _beginning(running)
    catalog, seconds = load_or_raise(running.tree), running.robot.seconds
    samples, cpu_seconds, conditions = Measurement(running, catalog, began).play()
    trace, workload = running.folder / "day.yaml", running.folder / "workload.yaml"
    period = ("--since", stamp(began), "--until", stamp(began + seconds))
    running.call("trace", "record", *period, "--file", str(trace))
    running.call("fit", "--manifests", str(running.tree), "--since", stamp(began), "--workload", str(workload))
    day = replace(read_trace(trace), duration=seconds)
    entries = [(parse_time(e["at"]) - began, e) for e in running.journal()]
    entries = [(at, e) for at, e in entries if 0 <= at <= seconds]
    actions = Counter(e["verb"] for _, e in entries if e["kind"] == "done")
    import pickle
    pickle.dump((entries, day, catalog), open(f"/tmp/e/{seconds}-{len(catalog.services)}-{len(day.events)}.pickle", "wb"))
    result = RunResult(
        "recorded", seconds, samples, _responses(catalog, day, entries), actions=actions, cpu_seconds=cpu_seconds
    )
    return Recorded(result, catalog, day, read_workload(workload), conditions)


def _beginning(running: Running) -> float:
    """When the manifests came into force, in seconds since the epoch; nothing runs yet."""
    running.client.status()
    return next(parse_time(e["at"]) for e in running.journal() if e["kind"] == "tree-accepted")


def _responses(catalog: Catalog, day: Trace, entries: Sequence[tuple[float, Mapping[str, Any]]]) -> Any:
    """How long each request took until the journal says that everything in it is ready."""
    responses, ready, asked = Responses(catalog), set[str](), list(day.events)
    for at, entry in [*entries, (day.duration, {"kind": ""})]:
        while asked and asked[0].at <= at:
            responses.asked(event := asked.pop(0))
            responses.look(ready.__contains__, event.at)
        if entry["kind"] == "state":
            (ready.add if entry["state"] == "ready" else ready.discard)(entry["service"])
            responses.look(ready.__contains__, at)
    return tuple(responses.found)


class Measurement:
    """Plays the day, and measures what services use meanwhile."""

    def __init__(self, running: Running, catalog: Catalog, began: float) -> None:
        self.running, self.began, self.samples = running, began, list[Sample]()
        self.meter = ServicesMeter(running.engine.usage, {name: one.cpu for name, one in catalog.services.items()})
        self.asks = list(running.robot.day)

    @property
    def now(self) -> float:
        return time.time() - self.began

    def play(self) -> tuple[tuple[Sample, ...], float, Conditions]:
        """Samples, CPU seconds of the services, and the machine meanwhile."""
        self.meter.look(())
        before = self._others(), time.monotonic()
        for number in range(1, round(self.running.robot.seconds / LOOK) + 1):
            self._until(number * LOOK)
            self._look(sample=number % LOOKS == 0)
        other = (self._others() - before[0]) / (time.monotonic() - before[1])
        return tuple(self.samples), self.meter.cpu_seconds, Conditions(machine()["cores"], other, self.meter.stand_ins)

    def _others(self) -> float:
        """CPU seconds of everything but this process, rorg and the services."""
        return machine()["cpu_seconds"] - time.process_time() - self.running.cpu_seconds() - self.meter.cpu_seconds

    def _until(self, at: float) -> None:
        while self.asks and self.asks[0].at <= at:
            time.sleep(max(0.0, self.asks[0].at - self.now))
            self.running.ask(self.asks.pop(0))
        time.sleep(max(0.0, at - self.now))

    def _look(self, sample: bool) -> None:
        before, containers = self.meter.cpu_seconds, tuple(self.running.engine.list())
        self.meter.look(containers)
        if sample:
            active, paused = (frozenset(c.service for c in containers if c.state == s) for s in ("running", "paused"))
            cpu = (self.meter.cpu_seconds - before) / LOOK
            self.samples.append(Sample(self.now, cpu, self.meter.memory, active, paused))


# -- figures -----------------------------------------------------------------------------------------------------------


def figures(result: RunResult) -> dict[str, Any]:
    """What is compared of a run: cores, bytes, seconds."""
    waits = [one.seconds for one in result.responses if one.seconds is not None]
    return {
        "calls": dict(sorted((result.actions or {}).items())),
        "cpu": round(result.cpu, 4),
        "memory": round(result.memory),
        "waits": {
            "count": len(result.responses),
            "never": len(result.responses) - len(waits),
            "median": round(median(waits), 4),
            "sum": round(sum(waits), 4),
            "longest": round(max(waits), 4),
        },
    }


def compared(run: Recorded, workload: Workload) -> dict[str, Any]:
    """The figures of a simulation of a recorded day, and how often the same services are active."""
    found = simulate(run.catalog, run.trace, workload, 1, every=0.05, learned=Learned())
    agreed = agreement(found, run.result)
    times = {"services": round(agreed.services, 4), "sets": round(agreed.sets, 4), "differing": dict(agreed.differing)}
    return {**figures(found), "agreement": times}


def robot_figures(run: Recorded) -> dict[str, Any]:
    return {
        "seconds": run.trace.duration,
        "services": sum(not one.meta for one in run.catalog.services.values()),
        "other_cpu": round(run.conditions.other, 4),
        "invalid": [flaw.why for flaw in flaws(run.conditions, ())],
        "recorded": figures(run.result),
        "learnt": compared(run, run.workload),
        "declared": compared(run, Workload("manifests")),
    }


@contextmanager
def engine() -> Iterator[str]:
    """A private Docker engine, with the image of the stand-ins."""
    if missing := Dockerd.missing():
        sys.exit(f"cannot record: {missing}")
    with tempfile.TemporaryDirectory(prefix="rorg-dockerd.") as folder:
        docker = Dockerd(Path(folder))
        docker.start()
        try:
            import_base(docker.host)
            os.environ["DOCKER_HOST"] = docker.host
            yield docker.host
        finally:
            docker.close()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--anyway", type=Path, metavar="FILE", help="measure also on a busy machine, into this file")
    parser.add_argument("names", nargs="*", help="robots; default: all")
    chosen = parser.parse_args()
    found: dict[str, Any] = {"machine": {"cores": machine()["cores"]}, "robots": {}}
    with engine() as host:
        for name, make in ROBOTS.items():
            if chosen.names and name not in chosen.names:
                continue
            print(f"recording {name}", flush=True)
            run = record(make(), host)
            if chosen.anyway:
                import pickle
                pickle.dump(run, open(f"/tmp/e/{name}.pickle", "wb"))
            found["robots"][name] = robot_figures(run)
            print(json.dumps(found["robots"][name], indent=1), flush=True)
    (chosen.anyway or FILE).write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
