"""Runs a robot with `rorg run` for its day, and records it: with the commands of rorg, from its journal, and by looking
at its containers."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import psutil
from recorded_robots import Ask, Robot
from rorg_client import Client, NotFound, Refused, calls

from rorg.engines.make import make_engine
from rorg.history.database import Database
from rorg.history.journal import ALL, Filter, Journal
from rorg.host.load import machine
from rorg.manifest.load import load_or_raise
from rorg.manifest.traces import read_trace
from rorg.manifest.workloads import read_workload
from rorg.model.catalog import Catalog
from rorg.model.trace import Trace
from rorg.model.units import parse_time, stamp
from rorg.model.workload import Workload
from rorg.store.state_dir import StateDir
from rorg.tools.sim.meters import ServicesMeter
from rorg.tools.sim.results import Response, Responses, RunResult, Sample
from rorg.tools.sim.validity import Conditions

LOOK, LOOKS = 0.25, 4
"""Seconds between two looks at what services use; looks for each sample."""
PATIENCE = 180.0
"""Seconds to wait for rorg to answer or end."""
DAEMONS = ("dockerd", "containerd", "containerd-shim")
"""The names of an engine's processes, of which the system keeps fifteen letters."""
Entry = tuple[float, Mapping[str, Any]]
"""Seconds since the day began, and what the journal says."""


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
        self.state, self.host = folder / "state", host
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
            with contextlib.suppress(NotFound):  # it was refused
                self.client.do(calls.release(one.id, one.by))
            return
        body: dict[str, Any] = {"services": list(one.services), "reason": "", "priority": None, "ttl": one.ttl}
        with contextlib.suppress(Refused):  # a conflict with another request, which a robot must live with
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
    result = RunResult(
        "recorded", seconds, samples, _responses(catalog, day, entries), actions=actions, cpu_seconds=cpu_seconds
    )
    return Recorded(result, catalog, day, read_workload(workload), conditions)


def _beginning(running: Running) -> float:
    """When the manifests came into force, in seconds since the epoch; nothing runs yet."""
    running.client.status()
    return next(parse_time(e["at"]) for e in running.journal() if e["kind"] == "tree-accepted")


def _responses(catalog: Catalog, day: Trace, entries: Sequence[Entry]) -> tuple[Response, ...]:
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


class EngineMeter:
    """CPU seconds of a private engine: its daemons, and what each container has of its own. What a process used after
    the last look is lost, so look often. `folder`: of the engine; its processes name it."""

    def __init__(self, folder: str) -> None:
        self.folder, self.seconds = folder, 0.0
        self._before = self._now()

    def look(self) -> float:
        """The seconds since it was made."""
        before, self._before = self._before, self._now()
        self.seconds += sum(max(0.0, used - before.get(process, 0.0)) for process, used in self._before.items())
        return self.seconds

    def _now(self) -> dict[psutil.Process, float]:
        found = dict[psutil.Process, float]()
        for process in psutil.process_iter(["name"]):
            with contextlib.suppress(psutil.Error):
                if process.info["name"] in DAEMONS and any(self.folder in word for word in process.cmdline()):
                    found[process] = sum(process.cpu_times()[:4])
        return found


class Measurement:
    """Plays the day, and measures what services use meanwhile."""

    def __init__(self, running: Running, catalog: Catalog, began: float) -> None:
        self.running, self.began, self.samples = running, began, list[Sample]()
        self.meter = ServicesMeter(running.engine.usage, {name: one.cpu for name, one in catalog.services.items()})
        self.daemons = EngineMeter(running.host.removeprefix("unix://").rpartition("/")[0])
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
        """CPU seconds of everything but this process, rorg, the engine and the services."""
        own = time.process_time() + self.running.cpu_seconds() + self.daemons.look() + self.meter.cpu_seconds
        return machine()["cpu_seconds"] - own

    def _until(self, at: float) -> None:
        while self.asks and self.asks[0].at <= at:
            time.sleep(max(0.0, self.asks[0].at - self.now))
            self.running.ask(self.asks.pop(0))
        time.sleep(max(0.0, at - self.now))

    def _look(self, sample: bool) -> None:
        before, containers = self.meter.cpu_seconds, tuple(self.running.engine.list())
        self.meter.look(containers)
        if sample:
            self.daemons.look()
            active, paused = (frozenset(c.service for c in containers if c.state == s) for s in ("running", "paused"))
            cpu = (self.meter.cpu_seconds - before) / LOOK
            self.samples.append(Sample(self.now, cpu, self.meter.memory, active, paused))
