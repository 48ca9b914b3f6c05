"""The robot of the demo: a temporary git repository with TritonBot's manifests, a shell in it, and an rorg that serves
it in a process of its own."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import psutil
from rorg_client import Client
from rorg_client import Error as ClientError

from rorg.core.observed import Container
from rorg.engines.make import available_engine
from rorg.errors import Invalid, NotReady
from rorg.manifest.load import load_or_raise
from rorg.model.catalog import Catalog
from rorg.tools.sim.throwaway import EMPTY, ThrowawayRobot

TRITONBOT = Path(__file__).parent / "tritonbot"
"""Its manifests and images, also in an installed rorg."""
ACTIONS: Mapping[str, tuple[str, ...]] = {
    "standby": ("ros_face_train_controller", "snowboy"),
    "chat": ("ros_face_train_controller", "snowboy", "gcloud_speech_action_server", "ros_speak_text"),
    "tour": ("navigation_route", "ros_speak_text", "leg_tracker"),
    "drive_back": ("navigation_route",),
}
"""What `behavioral` requests in actions 2 to 5 of the paper's figure 4. The demo declares each as a group."""
GROUP = """apiVersion: rorg/v1
kind: Group
metadata:
  name: {name}
spec:
  services: [{services}]
"""
IDENTITY = {
    f"GIT_{role}_{field}": value
    for role in ("AUTHOR", "COMMITTER")
    for field, value in (("NAME", "rorg demo"), ("EMAIL", "demo@localhost"))
}
END = 30.0
"""Seconds that rorg gets to end before the demo kills it. It needs less than one."""


def choose_engine(asked: str | None) -> tuple[str, str]:
    """(engine, why): the one asked for, or Docker if it answers, or processes."""
    if asked:
        return asked, "as asked for"
    return available_engine("demo")


class DemoRobot(ThrowawayRobot):
    """A temporary robot with the tour guide's tree in a repository. `rorg run` serves it as on a real robot, so that it
    can be killed, and can go on after the demo."""

    def __init__(self, engine: str) -> None:
        super().__init__(engine, "rorg-demo-")
        self.repository = self.folder / "robot"
        self.tree = self.repository / "manifests"
        self.log = self.folder / "rorg.log"
        self.scale = self._scale()
        self.server: subprocess.Popen[bytes] | None = None
        self._client = Client(str(self.state.run / "rorg.sock"), patience=0.0)
        self._environment = self._shell_environment()
        self._read = 0

    def _scale(self) -> float:
        """The stand-ins declare a robot of four cores and 16 GB; a laptop gets a share of that."""
        by_cpu = 0.6 * (os.cpu_count() or 1) / 3.58
        by_memory = 0.4 * psutil.virtual_memory().available / 3.4e9
        return round(min(1.0, by_cpu, by_memory), 2)

    def _shell_environment(self) -> dict[str, str]:
        """Return the environment of a person who works on this robot, without variables that name another one."""
        programs = self.folder / "bin"
        programs.mkdir()
        rorg = programs / "rorg"
        rorg.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m rorg "$@"\n')
        rorg.chmod(0o755)
        inherited = {k: v for k, v in os.environ.items() if not k.startswith("RORG_")}
        path = os.pathsep.join([str(programs), os.environ.get("PATH", os.defpath)])
        return {**inherited, **IDENTITY, "PATH": path, "RORG_STATE_DIR": str(self.state.path)}

    def set_up(self) -> Catalog:
        """Copy the tree into git, with container names of its own so that they do not clash with another robot's."""
        if not shutil.which("git"):
            raise Invalid("run the demo", "git is not installed here", "to install git, or add it to PATH")
        for part in ("manifests", "images"):
            shutil.copytree(TRITONBOT / part, self.repository / part)
        for name, services in ACTIONS.items():
            text = GROUP.format(name=name, services=", ".join(services))
            (self.tree / "groups" / f"{name}.yaml").write_text(text)
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
        for line in (
            "git init --quiet",
            "git config commit.gpgsign false",
            "git add --all",
            "git commit --quiet --message 'The robot'",
        ):
            self.shell(line)
        return load_or_raise(self.tree)

    def ignored_options(self, catalog: Catalog) -> list[str]:
        """The options of its services that this engine ignores."""
        declared = (frozenset(s.options) - frozenset(s.defaults) for s in catalog.services.values())
        return sorted(self.engine.capabilities.ignored(frozenset().union(*declared)))

    def shell(self, line: str) -> str:
        """Run a command line in the repository, and return its output. Raises NotReady if it fails."""
        done = subprocess.run(
            ["/bin/sh", "-c", line],
            cwd=self.repository,
            env=self._environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
        )
        if done.returncode:
            raise NotReady(f"run `{line}`", f"exit code {done.returncode}: {(done.stderr or done.stdout).strip()}")
        return done.stdout.strip()

    # -- rorg --------------------------------------------------------------------------------------------------

    def serve(self, line: str) -> None:
        """Start rorg with this command line, and wait until it knows what runs. It ignores the Ctrl-C that ends the
        demo: the demo ends it."""
        with self.log.open("ab") as log:
            self.server = subprocess.Popen(
                ["/bin/sh", "-c", f"exec {line}"],
                cwd=self.repository,
                env=self._environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                start_new_session=True,
            )
        self.wait("the start of rorg", self._serves)

    def _serves(self, view: Mapping[str, Any]) -> bool:
        if self.server is not None and self.server.poll() is not None:
            *_, last = ["", *self.log.read_text().splitlines()]
            raise NotReady("start rorg", last)
        return bool(view["services"] and view["engine"]["complete"])

    def view(self) -> Mapping[str, Any]:
        """The status that rorg answers, which knows of every command that has ended; EMPTY while it does not
        answer."""
        try:
            return self._client.status()
        except ClientError:
            return EMPTY

    def new_lines(self) -> list[str]:
        """Lines of rorg's log that were not read yet."""
        if not self.log.exists():
            return []
        with self.log.open() as log:
            log.seek(self._read)
            lines = log.read().splitlines()
            self._read = log.tell()
        return lines

    # -- what the engine says ----------------------------------------------------------------------------------

    def containers(self) -> tuple[Container, ...]:
        return tuple(self.engine.list()) if self.has_run else ()

    def container(self, service: str) -> Container:
        """The container of a service that runs."""
        return next(c for c in self.containers() if c.service == service and c.alive)

    # -- the end -----------------------------------------------------------------------------------------------

    @property
    def has_run(self) -> bool:
        return self.server is not None

    def leave(self) -> None:
        """End rorg, but no service."""
        if self.server is None:
            return
        self._client.close()
        self.server.terminate()
        try:
            self.server.wait(END)
        except subprocess.TimeoutExpired:
            self.server.kill()
            self.server.wait()
