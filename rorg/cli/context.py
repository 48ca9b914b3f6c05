"""What commands look at: the state directory, the manifests, the engine, and the current state of the robot."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from rorg_client import Client
from rorg_client import Error as ClientError

from rorg.cli.output import Notices, note
from rorg.cli.places import NAME, find, handshake, may_connect, nobody
from rorg.cli.terminal import hide
from rorg.errors import Invalid, NotReady, Unreachable, advice
from rorg.model.engines import DEFAULT_ENGINE, ENGINES
from rorg.store.state_dir import read_json

if TYPE_CHECKING:
    # Imported inside functions: what the running rorg answers needs none of them, and they take a quarter second.
    from rorg.core.masking import Masker
    from rorg.engines.protocol import RealEngine
    from rorg.model.catalog import Catalog
    from rorg.store.requests_document import RequestsDocument


T = TypeVar("T")
ROBOT = "RORG_ROBOT"
"""The variable that names a robot of a fleet; `--robot` sets it."""
ANSWER = 2.0
"""Seconds that the running rorg may hold back an answer until there is nothing to wait for."""


class Context:
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
        self.place = find(state_dir, own)
        self.remote, self.state = self.place
        self._engine_name = known_engine(engine)
        self.directory, self._local = directory, local
        self._engine: RealEngine | None = None
        self._client: Client | None = None
        self._unanswered: Unreachable | None = None
        """Why the running rorg did not answer; then it is not asked again."""
        self.silence = ""
        """Why the running rorg does not know what runs, if it was asked: its engine does not answer."""
        self.notices = Notices()

    @property
    def engine_name(self) -> str:
        """The engine that was asked for, or the one with the robot's containers, or the one of the last run."""
        if not self._engine_name:
            from rorg.store.engine_record import read_engine

            known = read_engine(self.state)
            self._engine_name = known_engine(known.name if known else self._last_text("engine_name") or DEFAULT_ENGINE)
        return self._engine_name

    def last(self) -> dict[str, Any] | None:
        """What an rorg published last, whether it still runs or not."""
        return read_json(self.state.status)

    def live(self, settled: float = 0.0) -> dict[str, Any] | None:
        """What the running rorg answers once everything is at rest, or after `settled` seconds. A user who may not call
        it can still read what it publishes."""
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
        """What the running rorg publishes, slightly later but at no cost to it; None if none runs or it has published
        nothing."""
        if self.remote:
            return None
        owner, status = self.state.owner(), self.last()
        if not (owner and status and status.get("pid") == owner.get("pid")):
            return None
        from rorg.api.status_models import is_status

        return status if is_status(status) else None

    def _published_before(self, error: Unreachable) -> dict[str, Any]:
        """What a running rorg that does not answer published last. Raises the error if it published nothing."""
        found = self.published()
        if found is None:
            raise error
        at = time.strftime("%H:%M:%S", time.gmtime(os.stat(self.state.status).st_mtime))
        self.notices.say(f"{error.why}; this is what it published at {at} UTC{advice(error.remedy)}")
        return found

    def _last_text(self, *keys: str) -> str:
        """A text of what an rorg published last; empty if it has none."""
        found: Any = self.last()
        for key in keys:
            found = found.get(key) if isinstance(found, dict) else None
        return found if isinstance(found, str) else ""

    @property
    def root(self) -> Path:
        """The directory of manifests. Commands about a tree (`local`) look here first, those about the robot at the
        directory of its last run."""
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
        """Masks the secrets of all manifests that were read in everything that is shown."""
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

        last = self._last_text("tree", "robot")
        named = self.named_robot or (last if last in robots_of(self.root) else "")
        return robot_for(self.root, named, os.uname().nodename)

    def asked(self, path: str, here: Callable[[], T]) -> T:
        """What the running rorg answers; or the same computed here, if none serves or a directory was given."""
        client = None if self.directory else self.client()
        if client is None:
            return here()
        found: T = client.call("GET", path)
        return found

    def groups(self) -> list[dict[str, Any]]:
        """All groups, as the API shows them."""
        return self.asked("/v1/groups", lambda: _views().groups(self.catalog()))

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

    def client(self) -> Client | None:
        """A client of the rorg at a socket or an address, or of the one that runs on this state directory; None if none
        serves. Notes if its engine does not answer. Raises Refused if this user may not call it, and Unreachable if it
        does not answer itself."""
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
                self.notices.say(f"{self.silence}; states are those seen last")
            self._client = client
        return self._client

    def serving(self, what: str) -> Client:
        """The same; raises Unreachable if none serves."""
        found = self.client()
        if found is None:
            raise nobody(what, self.state)
        return found

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
        found = self.live()
        if not found:
            self.here("compute how it is")
            from rorg.cli.local import view

            found = view(self)
        self.notices.of(found, bool(self.silence))
        return found

    def wait(self, what: str, done: Callable[[dict[str, Any]], str], timeout: float) -> None:
        """Looks at the running rorg's status until `done` returns an empty text rather than what is missing. Raises
        NotReady."""
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
            # Answers take time that rorg needs for what is waited for, so the pauses grow.
            time.sleep(min(max(0.01, 0.1 * waited), 0.25))
        raise NotReady(f"wait for {what}", f"not ready after {timeout:g} s: {why}", "`rorg describe` for details")


def _views() -> Any:
    from rorg.api import views

    return views


def bad_requests(path: Path, told: str) -> Invalid:
    """The error for the requests file; `told` may have its own remedy."""
    return Invalid(f"read {path}", told, "" if "; try " in told else "to fix it")


def known_engine(given: str | None) -> str:
    """The name of an engine, by default that in RORG_ENGINE; empty without either. Raises Invalid for an unknown
    one."""
    engine = given or os.environ.get("RORG_ENGINE") or ""
    if engine and engine not in ENGINES:
        raise Invalid(f"use the engine '{engine}'", "no such engine", " or ".join(ENGINES))
    return engine
