"""A world for rorg to be killed in: a tree, a state directory and an engine, the same at the beginning of each case."""

from __future__ import annotations

import contextlib
import copy
import os
import shutil
import signal
import subprocess
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import commands
from common import wait_for
from proof.engine_link import EngineServer, EngineWorld
from proof.promises import STRANGER
from proof.remains import Remains

from rorg.client import Client, Error, Unreachable
from rorg.core.observed import Container
from rorg.store.state_dir import StateDir

PROGRAM = str(Path(__file__).with_name("killed_run.py"))
NOT_UP: tuple[tuple[str, ...], tuple[int, bytes]] = (("sh", "-c", "false"), (1, b""))
"""A probe that always says no."""
QUARANTINED = "failed"
"""The code of a waiting that only another change of the manifests ends."""
PATIENCE = 20.0
"""Seconds in which everything must have come to rest."""
SCENARIO_FOLDERS = ("tree", "state", "upstream", "out")
"""What a case begins with."""


class Died(Exception):
    """rorg was killed while a step waited for something."""


class Prepared(commands.Forked):
    """rorg with its API made beforehand."""

    server = "assurance/proof/prepared_server.py"


class World(Remains):
    """Of one scenario; `folder` is its own."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.tree, self.state = folder, folder / "tree", StateDir(folder / "state")
        self.upstream, self.out = folder / "upstream", folder / "out"
        self.options: tuple[str, ...] = ()
        self.owner = f"proof-{os.getpid()}-{folder.name}"
        self.engine = EngineWorld(self.owner, dict([NOT_UP]))
        self.server = EngineServer(folder / "engine", self.engine)
        self.process: Prepared | None = None
        self.trace, self.command_trace = folder / "trace", folder / "command-trace"
        self.aim = (0, "after")
        """Point and side at which the next command that may be killed is killed."""
        self.kept: tuple[dict[str, Container], Any] = {}, None
        self.kept_world, self.kept_written = self.engine, dict[str, bytes]()
        self.images = self.loaded = False
        """Whether the engine has images, and the machine a load."""
        self.specs: dict[str, dict[str, Any]] = {}
        self.gone: set[str] = set()
        self.asked: dict[str, Any] = {}
        """Request -> the services that were acknowledged last, None once it is released; leases are left out."""
        self.doubtful: dict[str, list[Any]] = {}
        """Request -> values that were sent and not acknowledged."""
        self.deaths = 0
        self.unrest = ""
        """The plan for which it last was not at rest."""

    # -- what a case begins with ---------------------------------------------------------------------------------

    def wipe(self) -> None:
        for name in SCENARIO_FOLDERS:
            shutil.rmtree(self.folder / name, ignore_errors=True)
        self.state.prepare()
        (self.state.path / "instance").write_text(self.owner + "\n")
        self.engine.sim.containers[STRANGER] = Container(STRANGER, STRANGER, "", "running")

    def keep(self) -> None:
        """Make the present the beginning of every case."""
        kept = self.folder / "kept"
        shutil.rmtree(kept, ignore_errors=True)
        for name in SCENARIO_FOLDERS:
            if (self.folder / name).exists():
                shutil.copytree(self.folder / name, kept / name, symlinks=True, ignore=no_sockets)
        told = {name: copy.copy(getattr(self, name)) for name in ("specs", "gone", "asked")}
        told |= {"images": self.images, "loaded": self.loaded}
        self.kept = self.found(), (dict(self.engine.sim.objects), told)
        self.kept_world, self.kept_written = self.engine, self.written()

    def prepare(self, given: Callable[[Any], Any]) -> None:
        """Make the world that every case finds."""
        self.wipe()
        given(self)
        self.kill()
        self.keep()

    def restore(self) -> None:
        """Begin a case."""
        for name in SCENARIO_FOLDERS:
            shutil.rmtree(self.folder / name, ignore_errors=True)
            if (self.folder / "kept" / name).exists():
                shutil.copytree(self.folder / "kept" / name, self.folder / name, symlinks=True)
        self.engine = self.server.world = EngineWorld(self.owner, dict([NOT_UP]))
        containers, (objects, told) = self.kept
        self.engine.sim.containers.update(containers)
        for _ in range(len(containers) + len(objects) + 10):
            next(self.engine.sim._ids)
        self.engine.sim.objects.update(objects)
        self.engine.sim._ran.update({c: (0.0, 0.0) for c in containers})
        self.engine.take_over(self.kept_world)
        for name, value in told.items():
            setattr(self, name, copy.copy(value))
        self.begin(containers)

    def begin(self, containers: Mapping[str, Container]) -> None:
        """Begin the log of a case: what is there has answered its probe."""
        self.doubtful, self.deaths, self.aim = {}, 0, (0, "after")
        self.engine.log.add("given", containers=dict(containers))
        for container in (c for c in containers.values() if c.service):
            self.engine.log.add("exec", container.service, container.id, "0", containers=dict(containers))

    # -- rorg ------------------------------------------------------------------------------------------------------

    def environment(self, point: int, side: str) -> dict[str, str]:
        roots = os.pathsep.join(str(self.folder / name) for name in SCENARIO_FOLDERS)
        more = {"PROOF_ROOTS": roots, "PROOF_POINT": str(point), "PROOF_SIDE": side, "PROOF_TRACE": str(self.trace)}
        more |= {"PROOF_IMAGES": "1"} if self.images else {}
        more |= {"PROOF_LOAD": "1"} if self.loaded else {}
        return {**os.environ, **more, "PROOF_ENGINE": str(self.folder / "engine"), "RORG_STAY_DOWN": "1"}

    def start(self, point: int = 0, side: str = "after") -> None:
        for path in (self.trace, outcomes_of(self.trace)):
            path.unlink(missing_ok=True)
        trees = [] if "--git" in self.options else [str(self.tree)]
        words = ["run", *trees, "--state-dir", str(self.state.path), "--engine", "docker", *self.options]
        with (self.folder / "rorg.log").open("ab") as log:
            files = {"stdout": log, "stderr": log, "program": PROGRAM}
            self.process = Prepared(words, self.environment(point, side), self.folder, **files)  # type: ignore[arg-type]
        self.engine.log.add("run", text=f"killed {side} effect {point}" if point else "")

    def alive(self) -> bool:
        return self.process is not None and self.process.poll() is None

    def kill(self) -> None:
        if self.process is not None:
            self.process.kill()
            self.process.wait(60)

    def effects(self, of_command: bool = False) -> list[str]:
        """Of the last run, or of the command that may be killed, in order."""
        trace = self.command_trace if of_command else self.trace
        return trace.read_text().splitlines() if trace.exists() else []

    def outcomes(self, of_command: bool = False) -> dict[int, int]:
        """Effect -> how many outcomes a loss of power after it has, of a run without a kill."""
        trace = outcomes_of(self.command_trace if of_command else self.trace)
        lines = trace.read_text().splitlines() if trace.exists() else []
        return {int(number): int(many) for number, many in map(str.split, lines)}

    def client(self, patience: float = 0.0) -> Client:
        return Client(str(self.state.run / "rorg.sock"), timeout=PATIENCE, patience=patience)

    def when_alive(self, condition: Callable[[], Any], what: str) -> Any:
        """Wait for it. Raises Died as soon as rorg is gone."""

        def look() -> Any:
            found = condition()
            if not found and not self.alive():
                raise Died(what)
            return found

        try:
            return wait_for(look, PATIENCE, what)
        except AssertionError as error:
            raise AssertionError(f"{error}; {self.states()}; {self.unrest}") from None

    def call(self, method: str, path: str, body: Any = None) -> Any:
        """A call of the API, repeated until rorg serves or is dead."""
        self.when_alive(self._served, f"{method} {path}")
        answer = self.client().call(method, path, body)
        self.engine.log.add("told", text=f"{method} {path} {body or ''}")
        return answer

    def _served(self) -> bool:
        with contextlib.suppress(Unreachable):
            self.client().call("GET", "/v1/engine")
            return True
        return False

    # -- steps -----------------------------------------------------------------------------------------------------

    def states(self) -> dict[str, str]:
        """Service -> state of the container that counts."""
        found = sorted(self.found().values(), key=lambda c: (c.alive, c.started_at))
        return {c.service: c.state for c in found if c.service}

    def until(self, **states: str) -> None:
        """Wait until services have these states; `gone` for no container."""
        wanted = {name.replace("_", "-"): state for name, state in states.items()}
        self.when_alive(lambda: {n: self.states().get(n, "gone") for n in wanted} == wanted, f"not so: {wanted}")

    def containers(self, name: str) -> list[Container]:
        return [c for c in self.found().values() if c.service == name]

    def found(self) -> dict[str, Container]:
        """All containers that the engine has."""
        return self.engine.sim.containers.copy()

    def git(self, *words: str, folder: Path | None = None) -> str:
        who = ["-c", "user.name=x", "-c", "user.email=x@x", "-c", "init.defaultBranch=main"]
        command = ["git", "-C", str(folder or self.tree), *who, *words]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()

    # -- the end ---------------------------------------------------------------------------------------------------

    def rest(self) -> dict[str, Any]:
        """What is there when nothing is to be done, twice."""
        for _ in range(2):
            status = self.when_alive(self._at_rest, "not at rest")
            self.engine.log.add("at rest", text=status["plan"]["summary"])
            self.reread()
        return self.end(status)

    def reread(self) -> None:
        """Let rorg read its files again."""
        if self.process is not None:
            self.process.send_signal(signal.SIGHUP)

    def _at_rest(self) -> Any:
        with contextlib.suppress(Error):
            found = self.client(1.0).call("GET", "/v1/status?settled=10")
            waitings = [w for w in found["plan"]["waitings"] if w["code"] != QUARANTINED]
            self.unrest = str(found["plan"])
            return None if found["plan"]["actions"] or waitings or found["in_flight"] else found
        return None

    def close(self) -> None:
        self.kill()
        self.server.shutdown()
        self.server.server_close()


def outcomes_of(trace: Path) -> Path:
    """The file beside a trace that says how many outcomes a loss of power has."""
    return trace.with_name(f"{trace.name}.outcomes")


def no_sockets(folder: str, names: list[str]) -> list[str]:
    return [n for n in names if Path(folder, n).is_socket()]
