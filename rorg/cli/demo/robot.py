"""The robot of the demo: a temporary git repository with TritonBot's manifests, and a loop."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import psutil

from rorg.daemon.wiring import make_tree
from rorg.engines.make import available_engine
from rorg.errors import Invalid
from rorg.manifest.load import load_or_raise
from rorg.model.catalog import Catalog
from rorg.tools.sim.throwaway import ThrowawayRobot

TRITONBOT = Path(__file__).parent / "tritonbot"
"""Its manifests and images, also in an installed rorg."""


def choose_engine(asked: str | None) -> tuple[str, str]:
    """(engine, why): the one asked for, or Docker if it answers, or processes."""
    if asked:
        return asked, "as asked for"
    return available_engine("demo")


class DemoRobot(ThrowawayRobot):
    """A temporary robot with the tour guide's tree in a repository."""

    def __init__(self, engine: str, show: Any) -> None:
        super().__init__(engine, "rorg-demo-")
        self.show = show
        self.tree = self.folder / "robot" / "manifests"
        self.scale = self._scale()

    def _scale(self) -> float:
        """The stand-ins declare a robot of four cores and 16 GB; a laptop gets a share of that."""
        by_cpu = 0.6 * (os.cpu_count() or 1) / 3.58
        by_memory = 0.4 * psutil.virtual_memory().available / 3.4e9
        return round(min(1.0, by_cpu, by_memory), 2)

    def set_up(self) -> Catalog:
        """Copies the tree into git, with container names of its own so that they do not clash with another robot's."""
        for part in ("manifests", "images"):
            shutil.copytree(TRITONBOT / part, self.folder / "robot" / part)
        profile = self.tree / "profiles" / "standin.yaml"
        profile.write_text(profile.read_text() + f'      STANDIN_SCALE: "{self.scale}"\n')
        profile.write_text(
            profile.read_text().replace(
                "    entrypoint: [standin]\n", "    entrypoint: [standin]\n    container_name: rorg-demo-${service}\n"
            )
        )
        data = self.folder / "data"
        for path in (self.tree / "services").glob("*.yaml"):
            path.write_text(re.sub(r"tritonbot_(\w+):", lambda m: f"{data}/{m[1]}:", path.read_text()))
        for name in ("log", "maps", "model", "opt"):
            (data / name).mkdir(parents=True)
        self.git("init", "--quiet")
        self.commit("the robot")
        return load_or_raise(self.tree)

    def git(self, *args: str) -> str:
        identity = ["-c", "user.name=rorg demo", "-c", "user.email=demo@localhost", "-c", "commit.gpgsign=false"]
        command = ["git", *identity, *args]
        try:
            done = subprocess.run(command, cwd=self.folder / "robot", capture_output=True, text=True)
        except FileNotFoundError:
            raise Invalid("run the demo", "git is not installed here", "to install git, or add it to PATH") from None
        if done.returncode:
            raise Invalid(f"git {args[0]}", done.stderr.strip())
        return done.stdout.strip()

    def commit(self, message: str) -> str:
        self.git("add", "--all")
        self.git("commit", "--quiet", "--message", message)
        return self.git("rev-parse", "--short", "HEAD")

    def start(self) -> None:
        self.run(make_tree(self.tree, self.state, self.engine.name), self.show.event, "rorg demo")

    def keep(self) -> None:
        """Ends the loop, and says how to go on with the services that it leaves."""
        self.leave()
        self.show.line(f"kept: its services go on. In two terminals, first: export RORG_STATE_DIR={self.state.path}")
        self.show.line(f"  rorg run {self.tree} --engine {self.engine.name}")
        self.show.line("  rorg get, rorg ui; at the end: rorg down")

    def meanwhile(self) -> None:
        """Redraws the table."""
        self.show.table(self)
