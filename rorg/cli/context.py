"""What commands look at: the state directory, the manifests, the engine, and how everything is right now."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rorg_client import Client
from rorg_client import Error as ClientError

from rorg.cli.handshake import handshake
from rorg.cli.notices import Notices
from rorg.cli.output import note
from rorg.cli.places import NAME, find, may_connect, nobody
from rorg.cli.terminal import hide
from rorg.errors import Invalid, NotReady, Unreachable
from rorg.model.engines import DEFAULT_ENGINE, ENGINES
from rorg.store.state_dir import read_json

if TYPE_CHECKING:
    # Imported where they are needed: what a running rorg answers takes none of them, and they cost a quarter second.
    from rorg.core.decide import Decision
    from rorg.core.masking import Masker
    from rorg.engines.protocol import RealEngine
    from rorg.model.catalog import Catalog
    from rorg.store.requests_document import RequestsDocument


ROBOT = "RORG_ROBOT"
"""The variable that names a robot of a fleet; `--robot` puts it there."""
ANSWER = 2.0
"""Seconds that the running rorg may hold an answer back until there is nothing to wait for."""


class Context:
    """One command's view of the robot. Options that were not given come from the running rorg, or from defaults."""

    def __init__(
        self,
        state_dir: Path | None,
        engine: str | None,
        directory: Path | None = None,
        local: bool = False,
        own: bool = False,
    ) -> None:
        """`local`: it is about a tree; `own`: about a state directory, whichever rorg is named by the environment."""
        self.place = find(state_dir, own)
        self.remote, self.state = self.place
        self._engine_name = known_engine(engine)
        self.directory, self._local = directory, local
        self._engine: RealEngine | None = None
        self._client: Client | None = None
        self._unanswered: Unreachable | None = None
        """The running rorg did not answer, and is not asked again."""
        self.silence = ""
        """Why the running rorg does not know what runs, as far as it was asked: its engine does not answer."""
        self.notices = Notices()

    @property
    def engine_name(self) -> str:
        """What was asked for, else where the robot's containers are, else what rorg was last run with."""
        if not self._engine_name:
            from rorg.store.engine_record import read_engine

            known = read_engine(self.state)
            self._engine_name = known_engine(known.name if known else self._last_text("engine_name") or DEFAULT_ENGINE)
        return self._engine_name

    def last(self) -> dict[str, Any] | None:
        """What a rorg published last, be it running or not."""
        return read_json(self.state.status)

    def live(self, settled: float = 0.0) -> dict[str, Any] | None:
        """What the running rorg says, once all is at rest, or after so many seconds. Who may not talk to it can still
        read what it publishes."""
        try:
            client = self.client()
        except Unreachable as error:
            return self._published_before(error)
        if client:
            try:
                found: dict[str, Any] = client.call("GET", f"/v1/status?settled={settled:g}")
                return found
            except ClientError:
                if self.remote:
                    raise
        return self.published()

    def published(self) -> dict[str, Any] | None:
        """What the running rorg publishes, a moment later, at no cost to it; None when none runs or it has not
        published yet."""
        if self.remote:
            return None
        owner, status = self.state.owner(), self.last()
        if not (owner and status and status.get("pid") == owner.get("pid")):
            return None
        from rorg.api.status_models import is_status

        return status if is_status(status) else None

    def _published_before(self, error: Unreachable) -> dict[str, Any]:
        """What a running rorg that does not answer has published last. Raises the error where it has not."""
        found = self.published()
        if found is None:
            raise error
        at = time.strftime("%H:%M:%S", time.gmtime(os.stat(self.state.status).st_mtime))
        self.notices.say(f"{error.why}; this is what it published at {at} UTC; try {error.remedy}")
        return found

    def _last_text(self, *keys: str) -> str:
        """A text of what a rorg published last; empty where it says none."""
        found: Any = self.last()
        for key in keys:
            found = found.get(key) if isinstance(found, dict) else None
        return found if isinstance(found, str) else ""

    @property
    def root(self) -> Path:
        """The directory of manifests. Commands about a tree (`local`) look here first, those about the robot at what
        it was last run with."""
        if self.directory:
            return self.directory
        last = self._last_text("tree", "root")
        if last and (not self._local or (self.state.owner() and not self.state.held)):
            return Path(last)
        if Path("manifests").is_dir():
            return Path("manifests")
        from rorg.manifest.documents import holds_manifests

        return Path(last) if last and not holds_manifests(Path()) else Path()

    @cached_property
    def masker(self) -> Masker:
        """Knows the secrets of all manifests that were read, and keeps them out of what is shown."""
        from rorg.core.masking import Masker

        found = Masker()
        hide(found)
        return found

    def catalog(self) -> Catalog:
        if not self._local:
            self.here("read its manifests")
        from rorg.manifest.load import load, usable

        loaded = load(self.root, engine="" if self._local else self.engine_name, robot=self.robot)
        self.masker.learn(loaded.read)
        return usable(self.root, loaded)

    @property
    def asked_robot(self) -> str:
        """The robot whose overlay was asked for, whether there is one or not."""
        return os.environ.get(ROBOT, "")

    @property
    def named_robot(self) -> str:
        """The same. Raises Invalid where the tree has none of that name."""
        from rorg.manifest.overlay import unknown_robot

        named = self.asked_robot
        if problem := unknown_robot(self.root, named):
            raise Invalid(f"use the robot '{named}'", f"{problem.where.file} has none of that name", problem.remedy)
        return named

    @property
    def robot(self) -> str:
        """The same, else the one that rorg was last run for, else the one called as this machine; empty for the base
        alone."""
        from rorg.manifest.overlay import robot_for, robots_of

        last = self._last_text("tree", "robot")
        named = self.named_robot or (last if last in robots_of(self.root) else "")
        return robot_for(self.root, named, os.uname().nodename)

    def groups(self) -> list[Any]:
        """All groups, as the API shows them."""
        client = None if self.directory else self.client()
        if client:
            return list(client.groups())
        found = self.catalog().groups.values()
        return [{"name": g.name, "services": list(g.services), "description": g.description} for g in found]

    def images(self) -> list[Any]:
        """All images, as the API shows them."""
        client = None if self.directory else self.client()
        if client:
            return list(client.call("GET", "/v1/images"))
        from rorg.api.views import images

        return images(self.catalog())

    def manifests(self) -> list[Any]:
        """All manifests of the tree, as the API shows them."""
        client = None if self.directory else self.client()
        if client:
            return list(client.manifests())
        self.here("read its manifests")
        from rorg.api.manifests import listed

        return listed(self.root)

    def members(self, name: str) -> tuple[str, ...]:
        """The services that a name stands for."""
        if self.directory or not self.client():
            return self.catalog().members(name)
        return tuple(next((g["services"] for g in self.groups() if g["name"] == name), [name]))

    def here(self, what: str) -> None:
        """Raises Refused when nothing but the running rorg is known of the robot."""
        if self.remote:
            raise self.place.too_far(what)

    def engine(self) -> RealEngine:
        self.here("use its engine")
        if self._engine is None:
            from rorg.engines.make import make_engine

            self._engine = make_engine(self.engine_name, self.state)
        return self._engine

    def document(self) -> RequestsDocument:
        """The requests file. Raises Invalid when it is broken."""
        from rorg.store.requests_file import RequestsFile

        file = RequestsFile(self.state.requests)
        file.read()
        if file.diagnostics:
            raise bad_requests(self.state.requests, str(file.diagnostics[0]))
        return file.document

    def client(self) -> Client | None:
        """A client of the rorg at a socket or an address, or of the one that runs on this state directory; None when
        none serves. Says so if its engine does not answer. Raises Refused where this user may not talk to it, and
        Unreachable if it does not answer itself."""
        path = self.state.run / NAME
        if not (self.remote or (self.state.owner() and os.path.exists(path))):
            return None
        if self._unanswered:
            raise self._unanswered
        if self._client is None:
            if self.remote and not self.place.elsewhere:
                may_connect(self.remote)
            client = Client(self.remote or str(path), patience=2.0)
            try:
                engine = handshake(client)
            except Unreachable as error:
                self._unanswered = error
                raise
            if engine.get("silent_since"):
                self.silence = str(engine["error"])
                self.notices.say(f"{self.silence}; states are those that were seen last")
            self._client = client
        return self._client

    def serving(self, what: str) -> Client:
        """The same, or Unreachable."""
        found = self.client()
        if found is None:
            raise nobody(what, self.state)
        return found

    def change(self, edit: Callable[[RequestsDocument], RequestsDocument]) -> None:
        """Changes what is asked of the robot, durably, and says so when nobody is there to do it."""
        from rorg.store.requests_file import RequestsFile

        self.state.prepare()
        with self.state.usable():
            RequestsFile(self.state.requests).change(edit)
        if self.state.owner() is None:
            note("no rorg runs here: it takes effect at the next `rorg run` or `rorg apply`")

    def decision(self, catalog: Catalog) -> Decision:
        """One pass without anything that could change the robot: observation, resolution, plan. Raises Unreachable."""
        from rorg.cli.local import decision

        return decision(self, catalog)

    def view(self) -> dict[str, Any]:
        """The published state of the running rorg; computed the same way when none runs."""
        found = self.live()
        if not found:
            self.here("compute how it is")
            from rorg.cli.local import view

            found = view(self)
        self.notices.of(found, bool(self.silence))
        return found

    def wait(self, what: str, done: Callable[[dict[str, Any]], str], timeout: float) -> None:
        """Looks at the running rorg's state until `done` returns an empty text, else why it is not done."""
        begun = time.monotonic()
        why = "it has not reported anything yet"
        while (waited := time.monotonic() - begun) < timeout:
            view = self.live(min(ANSWER, timeout - waited))
            if view is None and self.state.owner() is None:
                raise nobody(f"wait for {what}", self.state)
            if view is not None:
                why = done(view)
                if not why:
                    return
            # An answer costs rorg time that it needs for what is waited for: it is asked ever more rarely.
            time.sleep(min(max(0.01, 0.1 * waited), 0.25))
        raise NotReady(f"wait for {what}", f"not ready after {timeout:g} s: {why}", "`rorg describe` for details")


def bad_requests(path: Path, told: str) -> Invalid:
    """Of the requests file; `told` may have a remedy of its own."""
    return Invalid(f"read {path}", told, "" if "; try " in told else "fixing it")


def known_engine(given: str | None) -> str:
    """The name of an engine, by default RORG_ENGINE; empty without that. Raises Invalid where there is none of that
    name."""
    engine = given or os.environ.get("RORG_ENGINE") or ""
    if engine and engine not in ENGINES:
        raise Invalid(f"use the engine '{engine}'", "no such engine", " or ".join(ENGINES))
    return engine
