"""A shell beside a robot on processes: commands and what they print."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess

import commands
import pytest
import rorg_client
from common import wait_for
from robots import write_tree

SERVICES = {
    "roscore": {},
    "navigation": {"needs": ["roscore"], "idle": {"action": "pause"}},
    "base": {"always_on": True, "driver": {"groups": ["dialout"]}},
}


class Shell:
    """Commands against one state directory, on the process engine."""

    def __init__(self, folder) -> None:
        self.tree, self.state = folder / "tree", folder / "state"
        self.env = {**os.environ, "RORG_STATE_DIR": str(self.state), "RORG_ENGINE": "process", "TERM": "dumb"}
        self.daemon = None

    def __call__(self, *args: str, code: int = 0, **env: str) -> subprocess.CompletedProcess:
        return commands.rorg(*args, code=code, **{**self.env, **env})

    def run(self) -> None:
        self.daemon = commands.Forked(["run", self.tree], self.env)
        wait_for(lambda: "base" in self.active())

    def active(self) -> set[str]:
        """As the running rorg answers; what it publishes comes a moment later, and is all there is without one."""
        path, socket = self.state / "status.json", self.state / "run/rorg.sock"
        if self.daemon and socket.exists():
            with contextlib.suppress(rorg_client.Error):
                return {s["service"] for s in rorg_client.Client(str(socket)).services() if s["state"] == "running"}
            return set()
        services = json.loads(path.read_text())["services"] if path.exists() else {}
        return {n for n, s in services.items() if s["state"] == "running"}


@pytest.fixture
def shell(tmp_path):
    found = Shell(tmp_path)
    write_tree(found.tree, SERVICES, groups={"driving": {"services": ["navigation"]}})
    yield found
    if found.daemon:
        found.daemon.terminate()
        found.daemon.wait()
    if found.state.exists():
        from rorg.engines.make import make_engine
        from rorg.store.state_dir import StateDir

        engine = make_engine("process", StateDir(found.state))
        for container in engine.list():
            engine.stop(container.id, "SIGKILL", 5.0)
