"""The robot of the demo: a throw-away git repository with TritonBot's manifests, a loop, and what to clean up."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import psutil

from rorg.daemon.wiring import make_loop
from rorg.engines.make import make_engine
from rorg.engines.protocol import Usage
from rorg.errors import Invalid, NotReady, RorgError
from rorg.images.make import make_supplier
from rorg.images.order import Order, Result
from rorg.images.references import references_for
from rorg.manifest.load import load_or_raise
from rorg.model.catalog import Catalog, Request
from rorg.store.requests_file import RequestsFile
from rorg.store.state_dir import StateDir, read_json

TRITONBOT = Path(__file__).parent / "tritonbot"
"""Its manifests and images, also where rorg is installed."""


def choose_engine(asked: str | None) -> tuple[str, str]:
    """(engine, why): what was asked for, else Docker when it answers, else processes."""
    if asked:
        return asked, "as asked for"
    from rorg.engines.docker.engine import DockerEngine

    try:
        return "docker", f"Docker {DockerEngine('demo').ping()} answers"
    except RorgError as error:
        return "process", f"Docker does not answer: {error.why}"


class Told:
    """Shows how the building of images goes on."""

    def __init__(self, show: Any, names: Mapping[str, str]) -> None:
        self.show, self.names = show, names

    def began(self, order: Order) -> None:
        """What has ended is enough."""

    def step(self, order: Order, text: str) -> None:
        """Likewise."""

    def ended(self, result: Result) -> None:
        self.show.progress(f"{result.outcome:<8} {self.names.get(result.reference, result.reference)}")


class DemoRobot:
    """A robot with the tour-guide's tree in a folder of its own, and a loop of its own."""

    def __init__(self, engine: str, show: Any) -> None:
        self.show = show
        self.folder = Path(tempfile.mkdtemp(prefix="rorg-demo-"))
        self.tree = self.folder / "robot" / "manifests"
        self.state = StateDir(self.folder / "state").prepare()
        self.engine = make_engine(engine, self.state)
        self.requests = RequestsFile(self.state.requests)
        self.loop: Any = None
        self.new_images: list[str] = []
        self.builder: Any = None
        self.scale = self._scale()

    def _scale(self) -> float:
        """The stand-ins declare a robot of four cores and 16 GB; a laptop gets its share of that."""
        by_cpu = 0.6 * (os.cpu_count() or 1) / 3.58
        by_memory = 0.4 * psutil.virtual_memory().available / 3.4e9
        return round(min(1.0, by_cpu, by_memory), 2)

    # -- the repository ----------------------------------------------------------------------------------------

    def set_up(self) -> Catalog:
        """The tree in git, with names of its own so that no other robot's containers are in the way."""
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
            raise Invalid("run the demo", "git is not installed here", "installing git, or adding it to PATH") from None
        if done.returncode:
            raise Invalid(f"git {args[0]}", done.stderr.strip())
        return done.stdout.strip()

    def commit(self, message: str) -> str:
        self.git("add", "--all")
        self.git("commit", "--quiet", "--message", message)
        return self.git("rev-parse", "--short", "HEAD")

    # -- images and the loop -----------------------------------------------------------------------------------

    def build(self, catalog: Catalog) -> None:
        supplier = make_supplier(self.engine, self.state, self.engine.owner, os.cpu_count() or 1)
        content = references_for(self.engine.name, self.state.path).of(catalog)
        used = sorted({s.spec["image"] for s in catalog.services.values() if s.spec})
        self.builder = supplier.make_builder()
        names = content.names
        before = self.builder.there({*names, *names.values()})
        try:
            results = supplier.supply(catalog, content, used, Told(self.show, names))
        finally:
            self.new_images = sorted({*names, *names.values()} - before)
        failed = [r for r in results if r.outcome == "failed"]
        if failed:
            raise NotReady("build the stand-in images", f"{failed[0].reference}: {failed[0].message}")

    def run(self) -> None:
        self.state.acquire("rorg demo")
        self.loop = make_loop(self.tree, self.state, self.engine, self.show.event)
        self.thread = threading.Thread(target=self.loop.run, daemon=True)
        self.thread.start()

    def view(self) -> Mapping[str, Any]:
        return read_json(self.state.status) or {
            "services": {},
            "tree": {"errors": [], "fingerprint": ""},
            "plan": {"actions": [1], "waitings": []},
            "in_flight": {},
        }

    def wait(self, what: str, done: Callable[[Mapping[str, Any]], bool], seconds: float = 60.0) -> Mapping[str, Any]:
        """Until the published state is so; the table goes on meanwhile."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            view = self.view()
            if done(view):
                return view
            self.show.table(self)
            time.sleep(0.05)
        raise NotReady(f"show {what}", f"it did not happen within {seconds:g} s")

    def settle(self, what: str) -> Mapping[str, Any]:
        """Until all that was asked for runs, is ready, and nothing lingers."""
        return self.wait(
            what,
            lambda v: (
                not (v["plan"]["actions"] or v["plan"]["waitings"] or v["in_flight"])
                and all(s["health"] not in ("Progressing", "Degraded") for s in v["services"].values())
            ),
        )

    def active(self) -> set[str]:
        return {n for n, s in self.view()["services"].items() if s["state"] == "running"}

    def request(self, id: str, requester: str, services: list[str]) -> None:
        run = self.view()["services"].get(requester, {}).get("incarnation") or None
        self.requests.change(lambda a: a.put(Request(id, requester, tuple(services), incarnation=run)))
        self.wait(
            "the request",
            lambda v: (
                any(r["id"] == id and r["services"] == list(services) for r in v["requests"])
                if "requests" in v
                else False
            ),
        )

    def release(self, id: str, requester: str) -> None:
        self.requests.change(lambda a: a.without({(requester, id)}))
        self.wait("the release", lambda v: all(r["id"] != id for r in v.get("requests", [{"id": id}])))

    def usage(self) -> dict[str, Usage]:
        """By service."""
        containers = self.loop.observer.snapshot().containers
        found = self.engine.usage(containers)
        return {c.service: found[c.id] for c in containers if c.id in found}

    # -- the end -----------------------------------------------------------------------------------------------

    def leave(self) -> None:
        """Stops the loop; what runs goes on."""
        if self.loop:
            self.loop.stop()
            self.thread.join(60)
        self.state.release()

    def clean_up(self) -> None:
        """Stops and removes everything that the demo made. A second Ctrl-C does not leave half of it."""
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)
        self.show.line("cleaning up")
        self.leave()
        try:
            containers = self.engine.list()
            threads = [threading.Thread(target=self._remove, args=(c,)) for c in containers]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            if self.engine.name == "docker" and self.builder:
                self.builder.remove(self.new_images[::-1])
        except RorgError as error:
            self.show.line(f"not everything could be removed: {error}")
        shutil.rmtree(self.folder, ignore_errors=True)

    def _remove(self, container: Any) -> None:
        if container.alive:
            self.engine.stop(container.id, "SIGKILL", 5.0)
        self.engine.remove(container.id)
