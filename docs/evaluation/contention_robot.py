"""The robot of contention.py, its tour, and five ways to run it: everything on, the same with CPU shares, by a script
with Compose, by rorg, and by rorg with pauses and CPU shares."""

from __future__ import annotations

import json
import os
import random
import subprocess
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from common import BASE_IMAGE, wait_for
from rorg_process import RorgProcess

from rorg.manifest.load import load_or_raise
from rorg.manifest.traces import read_trace
from rorg.manifest.workloads import read_workload
from rorg.model.catalog import Service
from rorg.model.graph import closure
from rorg.tools.sim.simulate import all_on_services

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
CORES = os.cpu_count() or 1
FOREGROUND = ("control", "guide")
"""Services that this file adds to those of the manifests: a control loop, and what the visitors wait for."""
FAVOUR = 10240
"""CPU shares of the foreground in `shares` and `rested`, where others have 1024: as many times more as rorg gives under
pressure."""
START_WORK = 0.25
"""Part of a program's start time (workload.yaml) that is CPU time. The rest is waiting."""
FIRST_PORT = 21000
PATIENCE = 180.0
"""Seconds until services must be ready."""
BEHAVIOUR, FIRST_STATE = "behavioral", "standby"


# -- the tour ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Stop:
    """A part of the tour: the state that the robot enters, and then `times` times work for the visitors and a wait."""

    state: str
    work: float
    """CPU seconds."""
    wait: float
    """Seconds."""
    times: int = 1


TOUR = (
    Stop(FIRST_STATE, 0.0, 4.0),
    Stop("chat", 0.5, 4.0),
    Stop("tour", 0.75, 3.0, 4),
    Stop("return", 0.75, 3.0),
    Stop("standby", 0.0, 6.0),
    Stop("chat", 0.5, 4.0),
    Stop("standby", 0.0, 4.0),
)


def tour_of(seed: int, number: int, seconds: float) -> tuple[Stop, ...]:
    """The tour of a round: its waits last `seconds` in all, and each differs by up to a tenth from round to round."""
    chance = random.Random(f"{seed}/{number}")
    factor = seconds / sum(stop.wait * stop.times for stop in TOUR)
    return tuple(Stop(s.state, s.work, s.wait * factor * chance.uniform(0.9, 1.1), s.times) for s in TOUR)


# -- the robot ---------------------------------------------------------------------------------------------------------


class Robot:
    """The robot of manifests/, with a stand-in for each program. An unused program takes what workload.yaml says; what
    use adds is the work of the guide. `demand`: of all programs that can run together, in machines."""

    def __init__(self, demand: float) -> None:
        self.catalog = load_or_raise(ROOT / "manifests")
        self.hour = read_trace(HERE / "hour.yaml")
        self.states = {event.state: event.services for event in self.hour.events if event.state}
        self.all = all_on_services(self.catalog, self.hour)
        self.workload = read_workload(HERE / "workload.yaml")
        self.scale = demand * CORES / sum(self._idle(name) for name in self.all)
        self.ports = {name: FIRST_PORT + n for n, name in enumerate([*self.all, *FOREGROUND])}
        always = [n for n in self.all if self.catalog.services[n].always_on]
        self.asked_for = [BEHAVIOUR, *self.catalog.members("base")]
        """What somebody requests for the whole day."""
        self.base = self.closure([*always, *self.asked_for])

    def _idle(self, name: str) -> float:
        one = self.workload.of(name)
        use = one.cpu_idle or one.cpu
        return use.mean if use else self.catalog.services[name].cpu

    def closure(self, names: Collection[str]) -> frozenset[str]:
        return frozenset(n for n in closure(self.catalog.services, list(names)) if n in self.ports)

    def needed(self, state: str) -> frozenset[str]:
        """What runs in a state, with what is never without."""
        return self.base | self.closure(self.states[state])

    def cores(self, name: str) -> float:
        return 0.0 if name in FOREGROUND else self._idle(name) * self.scale

    def container(self, name: str, folder: Path) -> dict[str, Any]:
        """Its container, in the words of Compose and of our manifests. The control loop writes into the folder."""
        one = {"image": BASE_IMAGE, "network_mode": "host", "init": True}
        if name in FOREGROUND:
            where = "/run/contention/control" if name == "control" else str(self.ports[name])
            volumes = [f"{ROOT}/tests/support/programs:/programs:ro", f"{folder}:/run/contention"]
            return {**one, "command": ["python3", "/programs/foreground.py", name, where], "volumes": volumes}
        service, start = self.catalog.services[name], self.workload.of(name).start
        seconds = start.mean if start else 0.0
        environment = {
            "RORG_SERVICE": name,
            "STANDIN_CPU": f"{self.cores(name):.4f}",
            "STANDIN_MEMORY": str(service.memory),
            "STANDIN_READY": f"tcp:{self.ports[name]}",
            "STANDIN_START": f"{seconds:g}",
            "STANDIN_START_CPU": f"{START_WORK * seconds:g}",
        }
        volumes = [f"{ROOT}/images/standin:/standin:ro"]
        return {**one, "command": ["python3", "/standin/standin"], "environment": environment, "volumes": volumes}


# -- five ways to run it -----------------------------------------------------------------------------------------------


class Compose:
    """Starts and stops services with Docker Compose."""

    def __init__(self, folder: Path, services: Mapping[str, Mapping[str, Any]]) -> None:
        self.file = folder / "compose.json"
        self.file.write_text(json.dumps({"name": "contention", "services": services}))

    def _call(self, *words: str) -> subprocess.Popen[bytes]:
        return quiet([os.environ["COMPOSE"], "-f", str(self.file), *words])

    def up(self, names: Collection[str]) -> subprocess.Popen[bytes]:
        return self._call("up", "-d", "--no-deps", "--no-recreate", *sorted(names))

    def stop(self, names: Collection[str]) -> subprocess.Popen[bytes]:
        return self._call("stop", *sorted(names))

    def down(self) -> None:
        finish(self._call("down", "-t", "0"))


class PlainDocker:
    """The same with `docker start` and `docker stop`."""

    def __init__(self, _: Path, services: Mapping[str, Mapping[str, Any]]) -> None:
        self.services = services
        for name, one in services.items():
            options = ["--name", name, "--network", one["network_mode"], "--init"]
            options += [word for volume in one["volumes"] for word in ("-v", volume)]
            options += [word for k, v in one.get("environment", {}).items() for word in ("-e", f"{k}={v}")]
            options += ["--cpu-shares", str(one["cpu_shares"])] if "cpu_shares" in one else []
            finish(quiet(["docker", "create", *options, one["image"], *one["command"]]))

    def up(self, names: Collection[str]) -> subprocess.Popen[bytes]:
        return quiet(["docker", "start", *sorted(names)])

    def stop(self, names: Collection[str]) -> subprocess.Popen[bytes]:
        return quiet(["docker", "stop", *sorted(names)])

    def down(self) -> None:
        finish(quiet(["docker", "rm", "-f", *self.services]))


def quiet(words: list[str]) -> subprocess.Popen[bytes]:
    return subprocess.Popen(words, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def finish(call: subprocess.Popen[bytes]) -> None:
    _, said = call.communicate()
    if call.returncode:
        raise RuntimeError(f"{' '.join(map(str, call.args[:4]))} ...: {said.decode()[-500:]}")  # type: ignore[index]


class AllOn:
    """Everything runs all the time. `shares`: of the foreground tasks; 0 for the usual ones."""

    def __init__(self, robot: Robot, folder: Path, shares: int = 0) -> None:
        self.robot, self.on = robot, frozenset({*robot.all, *FOREGROUND})
        services = {name: robot.container(name, folder) for name in self.on}
        for name in FOREGROUND if shares else ():
            services[name]["cpu_shares"] = shares
        self.tool = (Compose if os.environ.get("COMPOSE") else PlainDocker)(folder, services)

    def begin(self) -> frozenset[str]:
        """Starts what runs before the tour, and returns its names."""
        finish(self.tool.up(self.on))
        return self.on

    def enter(self, state: str) -> None:
        """Has the services of a state started, and returns soon."""

    def end(self) -> None:
        self.tool.down()


class Script(AllOn):
    """On a change of state the script starts all services that are missing, in one call, and at the same time stops
    those that are no longer needed. Programs wait for each other by themselves."""

    def begin(self) -> frozenset[str]:
        self.calls: list[subprocess.Popen[bytes]] = []
        self.on = self._services(FIRST_STATE)
        return super().begin()

    def _services(self, state: str) -> frozenset[str]:
        return self.robot.needed(state) | {*FOREGROUND}

    def enter(self, state: str) -> None:
        self._finish()
        before, self.on = self.on, self._services(state)
        if missing := self.on - before:
            self.calls.append(self.tool.up(missing))
        if unneeded := before - self.on:
            self.calls.append(self.tool.stop(unneeded))

    def _finish(self) -> None:
        while self.calls:
            finish(self.calls.pop())

    def end(self) -> None:
        self._finish()
        super().end()


class Rorg:
    """The behaviour requests the services of each state. Idle policies, needs and priorities are those of manifests/,
    and the budget is all cores.

    `shares`: of the foreground tasks; 0 for the usual ones. With them, idle services are paused, not stopped."""

    def __init__(self, robot: Robot, folder: Path, host: str, shares: int = 0) -> None:
        self.robot, self.shares = robot, shares
        services = {name: self._manifest(robot.catalog.services[name], folder) for name in robot.all}
        for name in FOREGROUND:
            services[name] = {"always_on": True, "priority": 100, "protected": True, **self._run(name, folder)}
        services[BEHAVIOUR]["may_request"] = sorted({n for asked in robot.states.values() for n in asked})
        asked = {"requester": "developer", "services": robot.asked_for}
        policy = {"budget": {"cpu": CORES}}
        kinds: dict[str, dict[str, Any]] = {"requests": {"all-day": asked}, "policies": {"default": policy}}
        self.process = RorgProcess(folder, services, docker=host, **kinds)

    def _manifest(self, one: Service, folder: Path) -> dict[str, Any]:
        idle = {"action": "pause" if self.shares else one.idle.action, "linger": f"{one.idle.linger:g}s"}
        ready: dict[str, Any] = {}
        if one.ready and one.ready.kind == "tcp":
            ready = {"ready": {"tcp": self.robot.ports[one.name], "timeout": f"{PATIENCE:g}s"}}
        elif one.ready:
            ready = {"ready": {"delay": f"{one.ready.delay:g}s"}}
        return {
            "always_on": one.always_on,
            "needs": [n for n in one.needs if n in self.robot.ports],
            "idle": idle,
            "priority": one.priority,
            "resources": {"cpu": round(self.robot.cores(one.name), 4), "memory": one.memory},
            **ready,
            **self._run(one.name, folder),
        }

    def _run(self, name: str, folder: Path) -> dict[str, Any]:
        container = self.robot.container(name, folder)
        if self.shares and name in FOREGROUND:
            container["cpu_shares"] = self.shares
        return {"image": container.pop("image"), "command": container.pop("command"), "container": container}

    def begin(self) -> frozenset[str]:
        self.process.start(env={**os.environ, "DOCKER_HOST": self.process.docker})
        wait_for(lambda: Path(self.process.socket(BEHAVIOUR)).exists(), PATIENCE, "the socket of the behaviour")
        self.process.client().wait(BEHAVIOUR, timeout=PATIENCE)
        self.behaviour = self.process.client(BEHAVIOUR)
        self.enter(FIRST_STATE)
        return self.robot.needed(FIRST_STATE) | {*FOREGROUND}

    def enter(self, state: str) -> None:
        self.behaviour.request(*self.robot.states[state], id=BEHAVIOUR, ttl=None)

    def end(self) -> None:
        self.process.close()
