"""Robots to test on: the same words for a real loop over a real engine and for virtual time."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from dataclasses import replace
from pathlib import Path

import commands
import psutil
import witnesses
import yaml
from common import BASE_IMAGE, wait_for

from rorg.api.server import make_server
from rorg.client import Client
from rorg.core.decide import Decision
from rorg.core.holds import Moment, begin_hold
from rorg.core.memory import Memory
from rorg.daemon.saved_memory import remembered, saved_progress
from rorg.daemon.wiring import make_loop
from rorg.engines.make import make_engine
from rorg.host.clock import moment
from rorg.host.load import Meter
from rorg.manifest.load import load_or_raise
from rorg.model.catalog import Request
from rorg.store.requests_file import RequestsFile
from rorg.store.state_dir import StateDir, read_json
from rorg.tools.sim.robot import SimRobot

WORK = [
    "python3",
    "-S",
    "-c",
    "import signal\nends = 2, 15\nsignal.pthread_sigmask(signal.SIG_BLOCK, ends)\nsignal.sigwait(ends)",
]
"""A program that waits, and ends when told to, also by a signal that comes before it waits."""


DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
"""Properties write thousands of trees: in C where PyYAML has it."""


def write_tree(root: Path, services: dict[str, dict], **kinds: dict[str, dict]) -> Path:
    """A tree of manifests from specs by name. Services get the test image and WORK unless they say otherwise."""
    for folder, kind, specs in (
        ("services", "Service", services),
        ("groups", "Group", kinds.get("groups", {})),
        ("profiles", "Profile", kinds.get("profiles", {})),
        ("requests", "Request", kinds.get("requests", {})),
        ("policies", "Policy", kinds.get("policies", {})),
        ("networks", "Network", kinds.get("networks", {})),
        ("volumes", "Volume", kinds.get("volumes", {})),
        ("machines", "Machine", kinds.get("machines", {})),
    ):
        (root / folder).mkdir(parents=True, exist_ok=True)
        wanted = {f"{name}.yaml" for name in specs}
        for path in (root / folder).glob("*.yaml"):
            if path.name not in wanted:
                path.unlink()
        for name, spec in specs.items():
            if kind == "Service" and spec.get("type") != "meta":
                spec = {"image": BASE_IMAGE, "command": WORK, **spec}
            labels = {"labels": spec["labels"]} if kind == "Service" and "labels" in spec else {}
            spec = {key: value for key, value in spec.items() if not (key == "labels" and kind == "Service")}
            document = {"apiVersion": "rorg/v1", "kind": kind, "metadata": {"name": name, **labels}, "spec": spec}
            text = yaml.dump(document, Dumper=DUMPER, sort_keys=False)
            path = root / folder / f"{name}.yaml"
            if not path.exists() or path.read_text() != text:
                path.write_text(text)
    return root


def handed_on(decision: Decision, boot: str = "", rebooted: bool = False) -> Memory:
    """What the next rorg knows of a decision that was made in this boot."""
    memory, now = decision.memory, decision.situation.now
    saved = {name: saved_progress(step, memory.restarts.get(name), boot) for name, step in memory.progress.items()}
    return remembered(json.loads(json.dumps(saved)), 0.0 if rebooted else now, "next" if rebooted else boot)


class VirtualRobot:
    kind = "sim"

    def __init__(self, folder: Path) -> None:
        self.tree = folder / "tree"
        self.sim: SimRobot | None = None

    def declare(self, services: dict, **kinds: dict) -> None:
        catalog = load_or_raise(write_tree(self.tree, services, **kinds))
        if self.sim is None:
            self.sim = SimRobot(catalog)
        else:
            self.sim.declare(catalog)

    def change(self, edit) -> None:
        self.sim.document = edit(self.sim.document)

    def request(self, *services: str, id: str = "test", by: str = "developer", **more) -> None:
        run = None if by == "developer" else self.run_of(by)
        self.change(lambda asked: asked.put(Request(id, by, services, incarnation=run, **more)))

    def release(self, id: str = "test", by: str = "developer") -> None:
        self.change(lambda asked: asked.without({(by, id)}))

    def run_of(self, service: str) -> str:
        """Its incarnation."""
        return self.container(service).incarnation

    def hold(self, service: str, seconds: float, reason: str = "") -> None:
        self.change(lambda asked: replace(asked, holds={service: begin_hold(self.moment(), seconds, reason)}))

    def suspend(self, seconds: float, reason: str = "") -> None:
        self.change(lambda asked: replace(asked, suspended=begin_hold(self.moment(), seconds, reason)))

    def wall(self) -> float:
        return self.sim.wall

    def moment(self) -> Moment:
        return self.sim.moment

    def waits(self, service: str) -> str:
        """Why it waits, as the last pass said it."""
        return "; ".join(self.sim.decision.plan.reasons().get(service, ()))

    def wait(self, condition, seconds: float = 60.0) -> None:
        self.sim.run(lambda _: condition(), seconds)

    def settle(self) -> None:
        self.sim.settle()

    def containers(self):
        return list(self.sim.engine.list())

    def log(self) -> list[str]:
        return [text for _, text in self.sim.log]

    def now(self) -> float:
        return self.sim.now

    def requests(self):
        return self.sim.document.requests

    # behind its back
    def kill(self, service: str) -> None:
        self.sim.engine.kill(self.container(service).id)

    def drift(self, verb: str, service: str, *args) -> None:
        getattr(self.sim.engine, verb)(self.container(service).id, *args)

    def can(self, ability: str) -> bool:
        """Whether its engine has one of Capabilities."""
        return getattr(self.sim.engine.capabilities, ability)

    def close(self) -> None:
        pass

    def states(self) -> dict[str, str]:
        """Of the container that counts: one that is kept, to be gone back to, does not."""
        return {c.service: c.state for c in sorted(self.containers(), key=lambda c: (c.alive, c.started_at))}

    def active(self) -> set[str]:
        return {c.service for c in self.containers() if c.state == "running"}

    def container(self, service: str):
        found = sorted(self.containers(), key=lambda c: (c.alive, c.started_at), reverse=True)
        return next(c for c in found if c.service == service)


class RealRobot(VirtualRobot):
    def __init__(self, folder: Path, kind: str, host: str | None, with_server: bool = False, look=None) -> None:
        """`look`: what its loop measures in place of the whole machine."""
        self.with_server, self.server, self.look = with_server, None, look
        self.kind, self.tree, self.host = kind, folder / "tree", host
        self.state = StateDir(folder / "state").prepare()
        if host:
            os.environ["DOCKER_HOST"] = host
        self.engine = make_engine(kind, self.state)
        self.lines: list[str] = []
        self.shm = folder / "shm"
        """In place of /dev/shm, of which it is not alone."""
        self.loop = None
        self.plan, self.closed = "", False
        """Of the last loop that was stopped; whether it is over."""
        self.daemons: list[Daemon] = []
        witnesses.KNOWN.append(self)
        self.file = RequestsFile(self.state.requests)

    def declare(self, services: dict, **kinds: dict) -> None:
        write_tree(self.tree, services, **kinds)
        if self.loop is None:
            self.start()

    def start(self) -> None:
        """Starts a loop, as `rorg run` does."""
        self.state.acquire("rorg run")
        self.loop = make_loop(self.tree, self.state, self.engine, self.lines.append)
        self.loop.ros.shm.folder = self.shm
        if self.look:
            self.loop.sampler.meter = Meter(self.loop.clock, self.look)
        if self.with_server:
            self.server = make_server(self.loop, self.state, "rorg")
            self.server.start()
        self.thread = threading.Thread(target=self.loop.run, daemon=True)
        self.thread.start()

    def socket(self, service: str = "") -> str:
        """Where people, or a service, talk to it."""
        return str(self.state.run / (f"services/{service}" if service else "") / "rorg.sock")

    def client(self, service: str = "", **more) -> Client:
        return Client(self.socket(service), **more)

    def stop(self) -> None:
        if self.server:
            self.server.stop()
            self.server = None
        self.loop.stop()
        self.thread.join(60)
        assert not self.thread.is_alive()
        self.state.release()
        self.plan = self._plan()
        self.loop = None

    def change(self, edit) -> None:
        self.file.change(edit)

    def run_of(self, service: str) -> str:
        """Its incarnation, once the loop knows of it."""
        found = self.container(service).incarnation
        if self.loop:
            seen = self.loop.observer.snapshot
            self.wait(lambda: any(c.incarnation == found for c in seen().containers))
        return found

    def wall(self) -> float:
        return time.time()

    def moment(self) -> Moment:
        return moment()

    def status(self) -> dict:
        """What the loop published last."""
        return read_json(self.state.status) or {}

    def waits(self, service: str) -> str:
        waitings = self.status().get("plan", {}).get("waitings", [])
        return "; ".join(w["reason"] for w in waitings if w["service"] == service)

    def signal(self, service: str, name: str) -> None:
        """Sends a signal to its program, behind rorg's back."""
        container = self.container(service)
        if self.kind == "docker":
            self.engine.api().kill(container.id, name)
        else:
            for child in psutil.Process(container.pid).children():  # its leader is a shell that waits for it
                child.send_signal(signal.Signals[name])

    def wait(self, condition, seconds: float = 60.0) -> None:
        try:
            wait_for(condition, seconds)
        except AssertionError:
            raise AssertionError(f"not so within {seconds} s: {self.states()}") from None

    def settle(self) -> None:
        """Until a pass over files that have been read has nothing to do and nothing is under way."""
        generation = self.loop.generations.changed(manifest=True)
        self.loop.wakes.files_changed()
        self.wait(lambda: self.loop.generations.reached(generation) and self.quiet())

    def quiet(self) -> bool:
        """The last pass has nothing to do, nothing is under way, and all that is known is published."""
        decision = self.loop.decision
        return (
            decision is not None
            and not (decision.plan.actions or decision.plan.waitings)
            and (not self.loop.running.memory.in_flight and self.loop.publisher.due() is None)
        )

    def containers(self):
        return self.engine.list()

    def can(self, ability: str) -> bool:
        return getattr(self.engine.capabilities, ability)

    def log(self) -> list[str]:
        return list(self.lines)

    def requests(self):
        self.file.read()
        return self.file.document.requests

    def kill(self, service: str) -> None:
        container = self.container(service)
        if self.kind == "docker":
            self.engine.api().kill(container.id)
        else:
            os.killpg(container.pid, 9)

    def drift(self, verb: str, service: str, *args) -> None:
        getattr(self.engine, verb)(self.container(service).id, *args)
        if self.kind == "process" and verb in ("pause", "resume"):
            self.engine.changes.tell(self.container(service).id)

    def _plan(self) -> str:
        decision = self.loop.decision if self.loop else None
        return decision.plan.text() if decision else self.plan

    def told(self) -> str:
        """For a test that failed: what it said last, and its plan."""
        logs = [witnesses.last_lines(self.state.path.parent / "run.log")] if self.daemons else []
        return "\n".join([*self.lines[-witnesses.LINES :], *logs, "plan:", self._plan(), f"states: {self.states()}"])

    def close(self) -> None:
        self.closed = True
        for daemon in self.daemons:
            daemon.end()
        if self.loop:
            self.stop()
        assert not [line for line in self.lines if "internal error" in line]
        # The newest first: Podman removes no container that another one has joined.
        for container in sorted(self.engine.list(), key=lambda c: c.created_at, reverse=True):
            if container.alive:
                self.engine.stop(container.id, "SIGKILL", 5.0)
            self.engine.remove(container.id)


class Daemon:
    """`rorg run` as a process of its own."""

    def __init__(self, robot: RealRobot) -> None:
        self.robot, self.process, self.starts = robot, None, 0
        robot.daemons.append(self)

    def start(self) -> None:
        self.starts += 1
        robot = self.robot
        words = ["run", robot.tree, "--state-dir", robot.state.path, "--engine", robot.kind]
        with (robot.state.path.parent / "run.log").open("ab") as log:
            self.process = commands.Forked(words, stdout=log, stderr=log)

    def kill(self) -> None:
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()

    def end(self) -> None:
        """One that a failed test left running."""
        if self.process and self.process.poll() is None:
            self.kill()

    def stop(self) -> None:
        """As systemd or `docker stop` does it."""
        self.process.send_signal(signal.SIGTERM)
        assert self.process.wait(60) == 0

    def status(self) -> dict:
        status = read_json(self.robot.state.status) or {}
        return status if status.get("pid") == self.process.pid else {}

    def settled(self) -> bool:
        status = self.status()
        return bool(status) and not (status["plan"]["actions"] or status["plan"]["waitings"] or status["in_flight"])

    def settled_but_waiting(self) -> bool:
        """Nothing to do but to wait for something."""
        status = self.status()
        return bool(status) and not (status["plan"]["actions"] or status["in_flight"])
