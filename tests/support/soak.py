"""Steady work on a robot for minutes or hours: what rorg uses meanwhile, and whether what runs is what is asked for."""

from __future__ import annotations

import json
import random
import socket
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import commands
import docker
import psutil
import witnesses
import yaml
from common import free_port, wait_for
from robots import RealRobot, write_tree

PROGRAM = Path(__file__).parent / "programs/inspected.py"
SERVER = """
import pathlib, signal, socket, sys
for number in (2, 15):
    signal.signal(number, lambda *_: sys.exit(0))
listener = socket.socket()
listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
listener.bind(("127.0.0.1", int(sys.argv[1])))
listener.listen()
pathlib.Path("/tmp/ready").touch()
print("serving", flush=True)
while True:
    listener.accept()[0].close()
    print("asked", flush=True)
"""
CRASHING = ("crash-a", "crash-b", "crash-c")
PLAIN = ("map", "arm", "gripper", "dock", "speech", "display", "logger", "charger")
"""Services that are requested, restarted by hand and edited."""
PERCEPTION = ("camera", "lidar", "imu")


def server(probe: Mapping[str, object], port: int, **more: object) -> dict:
    return {"command": ["python3", "-S", "-c", SERVER, str(port)], "ready": dict(probe), **more}


def services() -> dict[str, dict]:
    """Twenty: with probes, needs, pauses and stops, one that requests, and some that crash again and again."""
    clock, camera, lidar, imu, localization = (free_port() for _ in range(5))
    soon = {"stop_grace_period": "2s"}
    pausing, stopping = {"idle": {"action": "pause", "linger": 0}}, {"idle": {"action": "stop", "linger": "1s"}}
    found: dict[str, dict] = {
        "clock": server({"tcp": clock}, clock, always_on=True, live={"tcp": clock, "interval": "2s"}),
        "camera": server({"log": "serving"}, camera, **pausing),
        "lidar": server({"tcp": lidar, "interval": "500ms", "failures": 3}, lidar, **pausing),
        "imu": server({"file": "/tmp/ready"}, imu, **stopping),
        "localization": server({"tcp": localization}, localization, needs=["camera", "lidar"], **stopping),
        "navigation": {"needs": ["localization", "map", "clock"], **stopping},
        "tour": {"always_on": True, "may_request": ["arm", "map"]},
        "diagnostics": {"always_on": True, "needs": ["clock"]},
    }
    found |= {name: {"idle": {"action": "pause" if n % 2 else "stop"}} for n, name in enumerate(PLAIN)}
    found["gripper"]["needs"] = ["arm"]
    for number, name in enumerate(CRASHING):
        script = f"echo begins; sleep {0.2 + number}; exit {number + 1}"
        found[name] = {"always_on": True, "command": ["sh", "-c", script]}
    found["standby"] = {"needs": ["charger"]}
    for spec in found.values():
        spec["container"] = dict(soon)
    return found


class SoakedRorg:
    """`rorg run` on a Docker engine, a process of its own that answers questions about its memory."""

    def __init__(self, folder: Path, host: str, tree: dict[str, dict], **kinds: dict) -> None:
        self.robot, self.host, self.asked = RealRobot(folder, "docker", host), host, folder / "inspected.sock"
        self.specs, self.kinds = tree, kinds
        self.log, self.closed = folder / "rorg.log", False
        write_tree(self.robot.tree, tree, **kinds)
        words = ["run", str(self.robot.tree), "--state-dir", str(self.robot.state.path), "--engine", "docker"]
        command = [sys.executable, str(PROGRAM), str(self.asked), *words]
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(command, stdout=log, stderr=log)  # no fork: its memory is its own
        self.seen = psutil.Process(self.process.pid)
        self.api = docker.APIClient(host, version="auto")
        witnesses.KNOWN.append(self)
        self.client = self.robot.client(patience=60.0)
        wait_for(self.asked.exists, 60)

    def told(self) -> str:
        return witnesses.last_lines(self.log)

    def ask(self, question: str):
        with socket.socket(socket.AF_UNIX) as connection:
            connection.connect(str(self.asked))
            connection.sendall(f"{question}\n".encode())
            with connection.makefile() as answer:
                return json.load(answer)

    def edit(self, name: str, **fields: object) -> None:
        """Changes one manifest in place, as an editor does."""
        self.specs = {**self.specs, name: {**self.specs[name], **fields}}
        write_tree(self.robot.tree, self.specs, **self.kinds)

    def close(self) -> None:
        self.closed = True
        self.process.terminate()
        try:
            self.process.wait(60)
        finally:
            self.process.kill()
            self.robot.close()


# -- the work --------------------------------------------------------------------------------------------------


class Work:
    """Does the same things at a steady rate, in a thread each, until stop()."""

    def __init__(self, rorg: SoakedRorg, excuse: Callable[[], bool], seed: int = 1) -> None:
        """`excuse`: whether a call may fail at the moment, because of a fault of the engine or the disk."""
        self.rorg, self.excuse, self.chance = rorg, excuse, random.Random(seed)
        self.counts: dict[str, int] = {}
        self.errors: list[str] = []
        self.excused = 0
        self._stop = threading.Event()
        self._edits = 0
        rates = ((self.request, 1.0), (self.requester, 3.0), (self.command, 2.0), (self.lease, 4.0), (self.edit, 10.0))
        rates += ((self.restart_by_hand, 15.0), (self.read, 0.5), (self.follow, 30.0))
        self._threads = [threading.Thread(target=self._steadily, args=rate, daemon=True) for rate in rates]

    def start(self) -> None:
        for thread in self._threads:
            thread.start()

    def stop(self) -> None:
        self._stop.set()
        for thread in self._threads:
            thread.join(120)
            assert not thread.is_alive(), thread
        if self._is_bad:
            self.edit(self.chance)

    def _steadily(self, do: Callable[[random.Random], None], every: float) -> None:
        chance, due = random.Random(f"{do.__name__} {self.chance.random()}"), time.monotonic()
        while not self._stop.wait(max(0.0, due - time.monotonic())):
            due = max(due + every, time.monotonic())
            try:
                do(chance)
            except Exception:
                self._failed(f"{do.__name__}: {traceback.format_exc()}")
            self.counts[do.__name__] = self.counts.get(do.__name__, 0) + 1

    def _failed(self, how: str) -> None:
        if self.excuse():
            self.excused += 1
        else:
            self.errors.append(how)

    def request(self, chance: random.Random) -> None:
        """Request, wait and release: services, a group, and what needs much."""
        names = chance.choice((("perception",), ("navigation",), ("standby",), chance.sample(PLAIN, 2)))
        with self.rorg.client.request(*names, wait=90.0):
            self._stop.wait(chance.choice((0.0, 0.2, 1.0)))

    def requester(self, chance: random.Random) -> None:
        """The same, by a service."""
        with self.rorg.robot.client("tour", patience=60.0).request(chance.choice(("arm", "map")), wait=90.0, ttl=20.0):
            self._stop.wait(0.2)

    def lease(self, chance: random.Random) -> None:
        """One that nobody renews or releases."""
        name = chance.choice(PLAIN)
        self._command("request", name, "--id", f"lease-{chance.randrange(1000)}", "--ttl", "2s")

    def command(self, chance: random.Random) -> None:
        name = chance.choice(list(self.rorg.specs))
        looks = (
            ("get",),
            ("get", "-o", "json"),
            ("why", name),
            ("describe", name),
            ("events", "--tail", "50"),
            ("events", "--service", name, "--since", "1m", "-o", "json"),
            ("timeline", name, "--since", "2m"),
            ("history",),
            ("diff",),
            ("logs", name, "--tail", "20"),
        )
        self._command(*chance.choice(looks))

    def _command(self, *words: str) -> None:
        done = commands.run([*words, "--state-dir", str(self.rorg.robot.state.path)], timeout=120.0)
        # `diff` finds differences while others work, and what a service is like is told by `logs` once it has run.
        if done.returncode not in (0, 1):
            self._failed(f"rorg {' '.join(words)}: exit {done.returncode}\n{done.stdout}{done.stderr}")

    def edit(self, chance: random.Random) -> None:
        """Updates a service; every fifth time by a command that fails, which is put right by the next edit."""
        self._edits += 1
        name, number = PLAIN[(self._edits - 1) // 5 % len(PLAIN)], str(self._edits)
        spec = self.rorg.specs[name]
        command = {"command": ["sh", "-c", f"exit {self._edits % 100}"]} if self._is_bad else {}
        self.rorg.specs[name].pop("command", None)
        self.rorg.edit(name, container={**spec["container"], "environment": {"EDITION": number}}, **command)

    @property
    def _is_bad(self) -> bool:
        """Whether the last edit was one that fails."""
        return self._edits % 5 == 4

    def restart_by_hand(self, chance: random.Random) -> None:
        """Behind rorg's back, or by it."""
        if chance.random() < 0.5:
            self._command("restart", chance.choice(("clock", "diagnostics")))
            return
        name = chance.choice(("clock", "diagnostics", *PLAIN))
        for found in self.rorg.api.containers(filters={"label": f"rorg.io/service={name}"}):
            try:
                self.rorg.api.restart(found["Id"], timeout=2)
            except docker.errors.APIError as error:  # rorg has paused or removed it meanwhile
                if error.status_code not in (404, 409, 500):
                    raise

    def read(self, chance: random.Random) -> None:
        client = self.rorg.client
        chance.choice((client.services, client.status, client.requests, client.plan, client.usage, client.groups))()
        client.service(chance.choice(list(self.rorg.specs)))

    def follow(self, chance: random.Random) -> None:
        """Events, for some seconds, on a connection of its own that hangs up."""
        last = next(iter(self.rorg.client.events(tail=1)))["seq"]
        for event in self.rorg.client.events(cursor=max(0, last - 100), follow=True):
            if event["seq"] > last + 30 or self._stop.is_set():
                return


# -- what is to run --------------------------------------------------------------------------------------------


def wanted(tree: Path, requested: Iterable[str]) -> set[str]:
    """The services that must run, by the files of a tree and what is requested."""
    files: dict[str, dict[str, dict]] = {}
    for kind in ("services", "groups", "requests"):
        files[kind] = {p.stem: yaml.safe_load(p.read_text())["spec"] for p in (tree / kind).glob("*.yaml")}
    found: set[str] = set()
    ahead = [*requested, *(name for name, spec in files["services"].items() if spec.get("always_on"))]
    ahead += [name for spec in files["requests"].values() for name in spec["services"]]
    while ahead:
        name = ahead.pop()
        if name in files["groups"]:
            ahead += files["groups"][name]["services"]
        elif name not in found:
            found.add(name)
            ahead += files["services"][name].get("needs", ())
    return found


def runs(rorg: SoakedRorg) -> dict[str, list[tuple[str, str]]]:
    """Service -> (state, EDITION of its environment) of each of its containers, by the engine."""
    found: dict[str, list[tuple[str, str]]] = {}
    owner = (rorg.robot.state.path / "instance").read_text().strip()
    for listed in rorg.api.containers(all=True, filters={"label": f"rorg.io/owner={owner}"}):
        try:
            told = rorg.api.inspect_container(listed["Id"])
        except docker.errors.NotFound:
            continue
        environment = dict(e.partition("=")[::2] for e in told["Config"]["Env"])
        service = listed["Labels"]["rorg.io/service"]
        found.setdefault(service, []).append((listed["State"], environment.get("EDITION", "")))
    return found


def differences(rorg: SoakedRorg, requested: Iterable[str]) -> list[str]:
    """Where what runs is not what is asked for. What crashes all the time may be in any state."""
    asked, found, wrong = wanted(rorg.robot.tree, requested), runs(rorg), []
    for name in sorted({*rorg.specs, *found}):
        there = found.get(name, [])
        edition = rorg.specs.get(name, {}).get("container", {}).get("environment", {}).get("EDITION", "")
        if name not in rorg.specs:
            wrong.append(f"{name} is not declared, and has {there}")
        elif name in CRASHING:
            wrong += [f"{name} crashes, and has {there}"] if len(there) != 1 else []
        elif name in asked:
            wrong += [f"{name} is wanted, in edition '{edition}', and has {there}"] * (there != [("running", edition)])
        elif any(state == "running" for state, _ in there):
            wrong.append(f"{name} is not wanted, and has {there}")
    return wrong
