"""A robot of several computers: one real `rorg run` for each, over TLS on this machine."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from common import free_port, wait_for
from robots import write_tree
from rorg_client import Client

LEASE = 10.0


class Computer:
    """One machine. `enter`: words before its command, such as those that lead into its network."""

    def __init__(
        self, folder: Path, name: str, address: str, engine: str, host: str = "", enter: tuple[str, ...] = ()
    ) -> None:
        self.folder, self.name, self.address, self.engine, self.enter = folder / name, name, address, engine, enter
        self.tree, self.certificates = folder / "manifests", folder / "certificates"
        self.log = self.folder / "log"
        self.folder.mkdir(exist_ok=True)
        self.environment = {**os.environ, "RORG_RUN_DIR": str(self.folder / "run"), "RORG_STATE_DIR": str(self.folder)}
        if host:
            self.environment["DOCKER_HOST"] = host
        self.process: subprocess.Popen[bytes] | None = None
        self.client = Client(str(self.folder / "run/rorg.sock"))

    def start(self, wait: bool = True) -> None:
        """Starts rorg, and waits until it answers unless told otherwise."""
        words = ["run", self.tree, "--machine", self.name, "--engine", self.engine, "--listen", self.address]
        files = ["--certificates", self.certificates]
        with self.log.open("ab") as log:
            self.process = subprocess.Popen(
                [*self.enter, sys.executable, "-m", "rorg", *map(str, [*words, *files])],
                env=self.environment,
                stdout=log,
                stderr=log,
                stdin=subprocess.DEVNULL,
            )
        if wait:
            self.wait_for_start()

    def wait_for_start(self) -> None:
        wait_for(self.answers, 60, f"{self.name} to answer; it said {self.log.read_text()}")

    def answers(self) -> bool:
        try:
            return bool(self.client.call("GET", "/v1/status")["services"])
        except Exception:
            return False

    def end(self, number: int = signal.SIGKILL) -> None:
        if self.process is not None and self.process.poll() is None:
            self.process.send_signal(number)
            if number in (signal.SIGKILL, signal.SIGTERM):
                self.process.wait(30)

    def rorg(self, *words: str) -> subprocess.CompletedProcess[str]:
        """A command on this computer."""
        return subprocess.run(
            [*self.enter, sys.executable, "-m", "rorg", *words],
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=120,
            stdin=subprocess.DEVNULL,
        )

    def ask(self, id: str, *names: str) -> None:
        """Requests services for a person, until release."""
        self.client.call("PUT", f"/v1/requests/{id}", {"services": list(names)})

    def wait(self, *names: str, timeout: float = 30.0) -> None:
        self.client.wait(*names, timeout=timeout)

    def why(self, name: str) -> dict[str, Any]:
        return dict(self.client.why(name)[0])

    def services(self) -> dict[str, dict[str, Any]]:
        return {s["service"]: s for s in self.client.call("GET", "/v1/services")}

    def ready(self, name: str) -> bool:
        conditions = {c["type"]: c["status"] for c in self.services()[name]["conditions"]}
        return conditions["Ready"] == "True" and self.services()[name]["wanted"]

    def state(self, name: str) -> str:
        return str(self.services()[name]["state"])

    def link(self, to: str) -> str:
        return next(str(m["link"]) for m in self.client.call("GET", "/v1/machines") if m["name"] == to)

    def events(self, kind: str) -> list[dict[str, Any]]:
        return [dict(e) for e in self.client.events(tail=10_000, only={"kind": [kind]})]


class Team:
    """The computers of a robot, with one tree of manifests."""

    def __init__(
        self,
        folder: Path,
        services: Mapping[str, dict[str, Any]],
        names: tuple[str, ...] = ("base", "jetson"),
        engine: str = "process",
        make: Callable[[Path, str], Computer] | None = None,
    ) -> None:
        self.folder = folder
        self.addresses = {name: f"127.0.0.1:{free_port()}" for name in names}
        make = make or (lambda folder, name: Computer(folder, name, self.addresses[name], engine))
        self.computers = {name: make(folder, name) for name in names}
        self.addresses = {name: computer.address for name, computer in self.computers.items()}
        self.declare(services)
        words = ["certificate", str(folder / "manifests"), "--into", str(folder / "certificates")]
        subprocess.run([sys.executable, "-m", "rorg", *words], check=True, capture_output=True, timeout=60)

    def declare(self, services: Mapping[str, dict[str, Any]], folder: str = "manifests") -> Path:
        machines = {n: {"address": a, "lease": LEASE} for n, a in self.addresses.items()}
        return write_tree(self.folder / folder, dict(services), machines=machines)

    def start(self) -> None:
        for computer in self.computers.values():
            computer.start(wait=False)
        for computer in self.computers.values():
            computer.wait_for_start()
        for one in self.computers.values():
            for other in self.computers:
                wait_for(lambda a=one, b=other: a.link(b) == "up", 30, f"the link from {one.name} to {other}")

    def stop(self) -> None:
        for computer in self.computers.values():
            computer.end(signal.SIGCONT)
            computer.end(signal.SIGTERM)

    def down(self) -> None:
        """Leaves nothing of the robot: each rorg takes its part down, and ends."""
        for computer in self.computers.values():
            computer.end(signal.SIGCONT)
            if computer.process is not None and computer.process.poll() is None:
                computer.client.call("PUT", "/v1/down", {})
        for computer in self.computers.values():
            if computer.process is not None and computer.process.wait(60) != 0:
                computer.rorg("down", "--yes")
