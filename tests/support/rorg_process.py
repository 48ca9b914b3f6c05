"""A `rorg run` of its own, on processes or on Docker, seen from outside: started, ended, killed, started again."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import commands
import psutil
import witnesses
from robots import write_tree
from rorg_client import Client

from rorg.engines.make import make_engine
from rorg.store.state_dir import StateDir


class RorgProcess:
    def __init__(
        self, folder: Path, services: dict[str, dict], *options: str, docker: str = "", **kinds: dict[str, dict]
    ) -> None:
        """`docker`: the address of a Docker engine, in place of processes."""
        self.folder, self.tree, self.options = folder, write_tree(folder / "tree", services, **kinds), options
        self.engine, self.docker = "docker" if docker else "process", docker
        self.state = folder / "state"
        self.manifests = [str(self.tree)]
        """What it is told to run."""
        self.process: subprocess.Popen | commands.Forked | None = None
        self.closed = False
        witnesses.KNOWN.append(self)

    def told(self) -> str:
        """For a test that failed: what it said last."""
        return witnesses.last_lines(self.folder / "rorg.log")

    def start(self, **more: Any) -> RorgProcess:
        """`more`: what its process begins with."""
        words = ["run", *self.manifests, "--state-dir", str(self.state), "--engine", self.engine, *self.options]
        if self.docker:
            more = {"env": {**os.environ, "DOCKER_HOST": self.docker}, **more}
        with (self.folder / "rorg.log").open("ab") as log:
            if more:
                self.process = subprocess.Popen([sys.executable, "-m", "rorg", *words], stderr=log, stdout=log, **more)
            else:
                self.process = commands.Forked(words, stderr=log, stdout=log)
        return self

    def socket(self, service: str = "") -> str:
        return str(self.state / "run" / (f"services/{service}" if service else "") / "rorg.sock")

    def client(self, service: str = "", **more: float) -> Client:
        return Client(self.socket(service), **more)

    def stop(self, kill: bool = False) -> None:
        assert self.process is not None
        (self.process.kill if kill else self.process.terminate)()
        self.process.wait(60)

    def kill_service(self, pid: int) -> None:
        """With all its processes, behind rorg's back."""
        process = psutil.Process(pid)
        os.killpg(os.getpgid(pid), 9)
        psutil.wait_procs([process], timeout=60)

    def close(self) -> None:
        self.closed = True
        self.stop(kill=True)
        if self.docker:
            os.environ["DOCKER_HOST"] = self.docker
        engine = make_engine(self.engine, StateDir(self.state))
        for container in engine.list():
            if container.alive:
                engine.stop(container.id, "SIGKILL", 5.0)
            engine.remove(container.id)
