"""What commands look at: the manifests, the engine, the requests, and the current state of the robot."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from rorg.cli.connection import Connection
from rorg.cli.output import note
from rorg.cli.places import find
from rorg.cli.terminal import hide
from rorg.errors import Invalid
from rorg.model.engines import DEFAULT_ENGINE, ENGINES, SWARM

if TYPE_CHECKING:
    # Imported inside functions: what the running rorg answers needs none of them, and they take a quarter second.
    from rorg.core.masking import Masker
    from rorg.engines.protocol import RealEngine
    from rorg.model.catalog import Catalog
    from rorg.store.requests_document import RequestsDocument


T = TypeVar("T")
ROBOT = "RORG_ROBOT"
"""The variable that names a robot of a fleet; `--robot` sets it."""


class Context(Connection):
    """One command's view of the robot. Options that are not given come from the running rorg, or from defaults."""

    def __init__(
        self,
        state_dir: Path | None = None,
        engine: str | None = None,
        directory: Path | None = None,
        local: bool = False,
        own: bool = False,
    ) -> None:
        """`local`: the command is about a tree; `own`: about a state directory, even if the environment names a running
        rorg."""
        super().__init__(find(state_dir, own))
        self._engine_name = known_engine(engine)
        self.directory, self._local = directory, local
        self._engine: RealEngine | None = None

    @property
    def engine_name(self) -> str:
        """The engine that was asked for, or the one with the robot's containers, or the one of the last run."""
        if not self._engine_name:
            from rorg.model.machines import ANYWHERE, MACHINE
            from rorg.store.engine_record import EngineRecord, read_engine

            known = EngineRecord(SWARM) if os.environ.get(MACHINE) == ANYWHERE else read_engine(self.state)
            self._engine_name = known_engine(known.name if known else self.last_text("engine_name") or DEFAULT_ENGINE)
        return self._engine_name

    @property
    def root(self) -> Path:
        """The directory of manifests. Commands about a tree (`local`) look here first, those about the robot at the
        directory of its last run."""
        if self.directory:
            return self.directory
        last = self.last_text("tree", "root") or self._root_in_force()
        if last and (not self._local or (self.state.owner() and not self.state.held)):
            return Path(last)
        if os.path.isdir("manifests"):
            return Path("manifests")
        from rorg.manifest.documents import holds_manifests

        return Path(last) if last and not holds_manifests(Path()) else Path()

    def _root_in_force(self) -> str:
        """The directory of a running rorg that has published nothing yet: a loss of power took what there was."""
        view = self.live() if self.state.served and not self.remote else None
        return str(view["tree"]["root"]) if view else ""

    @cached_property
    def masker(self) -> Masker:
        """Masks the secrets of all manifests that were read in everything that is shown."""
        from rorg.core.masking import Masker

        masker = Masker()
        hide(masker)
        return masker

    def catalog(self) -> Catalog:
        if not self._local:
            self.here("read its manifests")
        from rorg.manifest.load import load, usable

        loaded = load(self.root, engine="" if self._local else self.engine_name, robot=self.robot)
        self.masker.learn(loaded.read)
        return usable(self.root, loaded)

    @property
    def asked_robot(self) -> str:
        """The robot whose overlay was asked for, even if there is none of that name."""
        return os.environ.get(ROBOT, "")

    @property
    def named_robot(self) -> str:
        """The same. Raises Invalid if the tree has no robot of that name."""
        from rorg.manifest.overlay import unknown_robot

        named = self.asked_robot
        if problem := unknown_robot(self.root, named):
            raise Invalid(f"use the robot '{named}'", f"{problem.where.file} has none of that name", problem.remedy)
        return named

    @property
    def robot(self) -> str:
        """The same, or the robot of the last run, or the one with the name of this machine; empty for the base
        alone."""
        from rorg.manifest.overlay import robot_for, robots_of

        last = self.last_text("tree", "robot")
        named = self.named_robot or (last if last in robots_of(self.root) else "")
        return robot_for(self.root, named, os.uname().nodename)

    def asked(self, path: str, here: Callable[[], T]) -> T:
        """What the running rorg answers; or the same computed here, if none serves or a directory was given."""
        client = None if self.directory else self.client()
        if client is None:
            return here()
        answer: T = client.call("GET", path)
        return answer

    def groups(self) -> list[dict[str, Any]]:
        """All groups, as the API shows them."""
        return self.asked("/v1/groups", self._groups)

    def _groups(self) -> list[dict[str, Any]]:
        from rorg.api.views import groups

        return groups(self.catalog())

    def members(self, name: str) -> tuple[str, ...]:
        """The services that a name stands for."""
        if self.directory or not self.client():
            return self.catalog().members(name)
        return tuple(next((g["services"] for g in self.groups() if g["name"] == name), [name]))

    def here(self, what: str) -> None:
        """Raises Refused if nothing is known of the robot but its running rorg."""
        if self.remote:
            raise self.place.too_far(what)

    def engine(self) -> RealEngine:
        self.here("use its engine")
        if self._engine is None:
            from rorg.engines.make import make_engine

            self._engine = make_engine(self.engine_name, self.state)
        return self._engine

    def document(self) -> RequestsDocument:
        """The requests file. Raises Invalid if it has mistakes."""
        from rorg.store.requests_file import RequestsFile

        file = RequestsFile(self.state.requests)
        file.read()
        if file.diagnostics:
            raise bad_requests(self.state.requests, str(file.diagnostics[0]))
        return file.document

    def change(self, edit: Callable[[RequestsDocument], RequestsDocument]) -> None:
        """Changes the requests file, durably, and notes if no rorg runs to act on it."""
        from rorg.store.requests_file import RequestsFile

        self.state.prepare()
        with self.state.usable():
            RequestsFile(self.state.requests).change(edit)
        if self.state.owner() is None:
            note("no rorg runs here; it takes effect at the next `rorg run` or `rorg apply`")

    def view(self) -> dict[str, Any]:
        """The status that the running rorg publishes; computed in the same way if none runs."""
        status = self.live()
        if not status:
            self.here("compute how it is")
            from rorg.cli.local import view

            status = view(self)
        self.notices.of(status, bool(self.silence))
        return status


def bad_requests(path: Path, told: str) -> Invalid:
    """The error for the requests file; `told` may have its own remedy."""
    return Invalid(f"read {path}", told, "" if "; " in told else "to fix it")


def known_engine(given: str | None) -> str:
    """The name of an engine, by default that in RORG_ENGINE; empty without either. Raises Invalid for an unknown
    one."""
    engine = given or os.environ.get("RORG_ENGINE") or ""
    if engine and engine not in ENGINES:
        raise Invalid(f"use the engine '{engine}'", "no such engine", " or ".join(ENGINES))
    return engine
