"""A robot on a real engine, in its own folder, with a loop in this process. It leaves nothing behind."""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from rorg.core.observed import Container
from rorg.daemon.loop import Loop
from rorg.daemon.tree import Tree
from rorg.daemon.wiring import loop_over
from rorg.engines.make import make_engine
from rorg.engines.protocol import Usage
from rorg.errors import EngineError, NotReady, RorgError
from rorg.images.order import Builder, Order, Result
from rorg.images.references import references_for
from rorg.images.supply import Supplier
from rorg.model.catalog import Catalog
from rorg.model.causes import causes
from rorg.store.requests_file import RequestsFile
from rorg.store.state_dir import StateDir, read_json

EMPTY: Mapping[str, Any] = {
    "services": {},
    "tree": {"errors": [], "fingerprint": ""},
    "plan": {"actions": [1], "waitings": []},
    "in_flight": {},
}
"""The status before the loop publishes one."""
ATTEMPTS = 3
"""To remove a container."""
LOOK = 0.05
"""Seconds between two looks while waiting."""


class Told:
    """Reports the result of each image."""

    def __init__(self, say: Callable[[str], None], names: Mapping[str, str]) -> None:
        self.say, self.names = say, names

    def began(self, order: Order) -> None:
        """Only results are reported."""

    def step(self, order: Order, text: str) -> None:
        """Only results are reported."""

    def ended(self, result: Result) -> None:
        self.say(f"{result.outcome:<8} {self.names.get(result.reference, result.reference)}")


class ThrowawayRobot:
    """A folder, state directory, engine and loop. End it with clean_up(), or with leave() to keep it."""

    def __init__(self, engine: str, prefix: str) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix=prefix))
        self.state = StateDir(self.folder / "state").prepare()
        self.engine = make_engine(engine, self.state)
        self.references = references_for(self.engine.name, self.state.path)
        self.requests = RequestsFile(self.state.requests)
        self.loop: Loop | None = None
        self._thread: threading.Thread | None = None
        self._builder: Builder | None = None
        self._new_images: list[str] = []

    def build(self, catalog: Catalog, say: Callable[[str], None]) -> None:
        """Builds or pulls the images of its services. `say` receives a line for each. Raises NotReady."""
        supplier = Supplier(self.engine, self.state, self.engine.owner, os.cpu_count() or 1)
        content = self.references.of(catalog)
        used = sorted({s.spec["image"] for s in catalog.services.values() if s.spec})
        self._builder = supplier.make_builder()
        names = content.names
        before = self._builder.there({*names, *names.values()})
        try:
            results = supplier.supply(catalog, content, used, listener=Told(say, names))
        finally:
            self._new_images = sorted({*names, *names.values()} - before)
        failed = [r for r in results if r.outcome == "failed"]
        if failed:
            raise NotReady("build the stand-in images", f"{failed[0].reference}: {failed[0].message}")

    def run(self, tree: Tree, say: Callable[[str], None], owner: str) -> Loop:
        """Starts and returns the loop. `say` receives a line for every event; `owner`: the command that runs it."""
        self.state.acquire(owner)
        self.loop = loop_over(tree, self.state, self.engine, say)
        self._thread = threading.Thread(target=self.loop.run, daemon=True)
        self._thread.start()
        return self.loop

    # -- status ------------------------------------------------------------------------------------------------

    def view(self) -> Mapping[str, Any]:
        """The status that the loop published last."""
        return read_json(self.state.status) or EMPTY

    def containers(self) -> tuple[Container, ...]:
        """Containers as the loop sees them."""
        return self.loop.observer.snapshot().containers if self.loop else ()

    def wait(self, what: str, done: Callable[[Mapping[str, Any]], bool], seconds: float = 60.0) -> Mapping[str, Any]:
        """Waits for a published status. Raises NotReady `seconds` after the last service began to run for the first
        time: a slow machine may take long to start many."""
        deadline, waits, ran = time.monotonic() + seconds, list[Mapping[str, Any]](), set[str]()
        while time.monotonic() < deadline:
            view = self.view()
            if done(view):
                return view
            waits = view["plan"]["waitings"]
            if new := {n for n, s in view["services"].items() if s["state"] == "running"} - ran:
                ran |= new
                deadline = time.monotonic() + seconds
            time.sleep(LOOK)
        why = "".join(f"; {cause}" for cause in causes((one["service"], one["reason"]) for one in waits))
        raise NotReady(f"wait for {what}", f"it did not happen, and no service began to run for {seconds:g} s{why}")

    def settle(self, what: str, seconds: float = 60.0) -> Mapping[str, Any]:
        """Waits until everything that was requested runs and is ready, and nothing lingers."""
        return self.wait(
            what,
            lambda v: (
                not (v["plan"]["actions"] or v["plan"]["waitings"] or v["in_flight"])
                and all(s["health"] not in ("Progressing", "Degraded") for s in v["services"].values())
            ),
            seconds,
        )

    def active(self) -> set[str]:
        return {n for n, s in self.view()["services"].items() if s["state"] == "running"}

    def usage(self) -> dict[str, Usage]:
        """Use by service."""
        containers = self.containers()
        usage_by_id = self.engine.usage(containers)
        return {c.service: usage_by_id[c.id] for c in containers if c.id in usage_by_id}

    # -- the end -----------------------------------------------------------------------------------------------

    @property
    def has_run(self) -> bool:
        """Whether there may be containers. Otherwise the engine need not answer for the robot to be removed."""
        return self.loop is not None

    def leave(self) -> None:
        """Stops the loop, but no containers."""
        if self.loop and self._thread:
            self.loop.stop()
            self._thread.join(60)
        self.state.release()

    def clean_up(self, say: Callable[[str], None]) -> None:
        """Stops and removes everything. A second Ctrl-C does not interrupt that. `say` hears what could not be
        removed."""
        before = {number: signal.signal(number, signal.SIG_IGN) for number in (signal.SIGINT, signal.SIGTERM)}
        try:
            self.leave()
            containers = self.engine.list() if self.has_run else []
            with ThreadPoolExecutor(len(containers) or 1) as pool:
                left = [why for why in pool.map(self._remove, containers) if why]
            if left:
                say(f"not everything could be removed: {left[0]}")
            if self.engine.capabilities.images and self._builder:
                self._builder.remove(self._new_images[::-1])
        except RorgError as error:
            say(f"not everything could be removed: {error}")
        finally:
            shutil.rmtree(self.folder, ignore_errors=True)
            for number, handler in before.items():
                signal.signal(number, handler)

    def _remove(self, container: Container) -> str:
        """Removes a container, which an action that was under way may start meanwhile. Returns why it is still there;
        empty if it is gone."""
        why = ""
        found: tuple[Container, ...] = (container,)
        for _ in range(ATTEMPTS):
            if not found:
                return ""
            try:
                if found[0].alive:
                    self.engine.stop(container.id, "SIGKILL", 5.0)
                self.engine.remove(container.id)
                return ""
            except EngineError as error:
                why = str(error)
                found = tuple(c for c in self.engine.list() if c.id == container.id)
        return why
