"""What the API offers, without HTTP: the running loop as callers may see and change it."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future
from dataclasses import replace
from typing import Any

from rorg.api.changes import Change, put_request
from rorg.api.current import Current, missing
from rorg.api.permissions import Caller, allow_request
from rorg.api.readiness import Question, Readiness, readiness
from rorg.core.decide import Decision, preview
from rorg.core.desired import Desired
from rorg.core.inputs import Inputs
from rorg.core.observed import Container
from rorg.core.status import Status, Statuses
from rorg.daemon.loop import Loop
from rorg.daemon.snapshot import about_tree, request_json
from rorg.engines.observe import REMEDY
from rorg.errors import Busy, Missing, Refused, Unreachable
from rorg.history.request_log import RequestLog
from rorg.host.listeners import calling, lineage, listening
from rorg.host.load import machine
from rorg.model.catalog import Catalog, Group, Request
from rorg.model.graph import closure
from rorg.model.health import Health
from rorg.store.committer import Committer
from rorg.store.requests_document import RequestsDocument
from rorg.store.requests_file import RequestsFile


class Operations:
    """Reads use the last decision of the loop. Changes go through the committer; when their future is done, they are on
    the disk. No method blocks for long."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self.recorder, self.tree, self.engine, self.state = loop.recorder, loop.tree, loop.engine, loop.state
        self.machines = loop.machines
        self.journal, self.requests_file, self.ros2 = loop.recorder.journal, loop.leases.file, loop.ros.ros2.exchange
        self.request_log = RequestLog(self.journal)
        self.next_pass: Callable[[], asyncio.Event] = asyncio.Event
        """An event that is set after the next pass of the loop; the server provides it."""
        self.committer = Committer(RequestsFile(loop.leases.file.path), self.changed)
        loop.leases.committed = self.committer.file
        self.ending = False
        """rorg is stopping: every call gets "busy", and nothing is accepted."""
        self._cached: tuple[Decision | None, Mapping[str, Status], dict[str, bytes]] = (None, {}, {})

    # -- reading -----------------------------------------------------------------------------------------------

    @property
    def last_decision(self) -> Decision | None:
        """The decision of the last pass, even if it has not read the tree."""
        return self._loop.decision

    @property
    def decision(self) -> Decision:
        """The decision of the last pass over a tree that has been read. Raises Busy before there is one."""
        decision = self.last_decision
        # An earlier pass may know nothing of services that the tree, read since, declares.
        if decision is None or not (decision.situation.desired.catalog.fingerprint or self.tree.errors):
            raise Busy("answer", "rorg has just begun and has not read its manifests yet", "again in a moment")
        return decision

    def changed(self, news: bool = True, manifest: bool = False) -> int:
        """The generation of a change that every reader sees now; without `news`, of the last one."""
        generations = self._loop.generations
        generation = generations.changed(manifest) if news else generations.latest
        self._loop.wake()
        return generation

    def open_to(self, generation: int) -> bool:
        """Whether a caller that knows of this generation may be answered. Raises Busy while rorg stops."""
        if self.ending:
            raise Busy("answer", "rorg is being stopped", "again in a moment")
        return self._loop.generations.reached(generation)

    @property
    def catalog(self) -> Catalog:
        return self.decision.situation.desired.catalog

    def statuses(self) -> Mapping[str, Status]:
        """The status of every declared service, each found at most once per decision."""
        decision = self.decision
        if self._cached[0] is not decision:
            self._cached = (decision, Statuses(decision.situation, decision.plan, decision.holds), {})
        return self._cached[1]

    def service_text(self, name: str) -> bytes:
        """The JSON of one service."""
        by_name = self.statuses()
        if name not in by_name:
            raise missing(name, set(by_name))
        texts = self._cached[2]
        if name not in texts:
            texts[name] = json.dumps(by_name[name].as_json()).encode()
        return texts[name]

    @property
    def at_rest(self) -> bool:
        """Whether there is nothing to do, nothing under way, and no service that is still coming up."""
        decision = self.decision
        if decision.plan.actions or decision.memory.in_flight or not decision.situation.observed.complete:
            return False
        return not any(
            s.health is Health.PROGRESSING or s.condition("Updated").reason == "OnTrial"
            for s in self.statuses().values()
        )

    @property
    def current(self) -> Current:
        errors = () if self.catalog.fingerprint else self.tree.errors
        return Current(self.decision, self.statuses(), self._loop.clock(), self.tree.commit is not None, errors)

    def snapshot(self) -> str:
        """The whole state in one answer, as StatusView. Raises Busy like `decision`."""
        _ = self.decision
        return self._loop.publisher.text(self.about_tree())

    def about_tree(self) -> dict[str, Any]:
        """The state of the manifests and of the requests file, including their errors."""
        return about_tree(self.tree, self.requests_file)

    @property
    def latest(self) -> int:
        """Generation of the last accepted change."""
        return self._loop.generations.latest

    def observe(self) -> None:
        """Looks at the engine now. Raises RorgError if it does not answer."""
        self._loop.observer.sync(False)

    @property
    def reading_files(self) -> bool:
        """Whether the loop still has to read files that changed."""
        return self._loop.wakes.files

    def files_changed(self, manifest: bool = False) -> int:
        """Makes the loop read the manifests again; the generation that has seen them."""
        self._loop.wakes.files_changed()
        return self.changed(manifest=manifest)

    def container_of(self, name: str) -> Container | None:
        """The container of a service that counts, as seen last."""
        return self._loop.running.container_of(name)

    def on_decision(self, call: Callable[[], None]) -> None:
        """`call` is called after each pass of the loop, in its thread."""
        self._loop.decided = call

    def suppose(self, desired: Desired) -> Decision:
        """The decision if this were declared."""
        decision, inputs = self.decision, self._loop.inputs
        assert inputs is not None, "there is one with each decision"
        return preview(inputs, decision.memory, desired)

    def inputs_now(self) -> Inputs:
        """What a pass would read now, as far as the last one knows."""
        decision, inputs = self.decision, self._loop.inputs
        assert inputs is not None, "there is one with each decision"
        return replace(inputs, memory=decision.memory, now=self._loop.clock(), wall=self._loop.wall())

    def readiness(self, question: Question) -> Readiness:
        """How far the services of a question, and all that they need, are."""
        return readiness(self.decision, self.statuses(), question)

    def heard_since(self, question: Question) -> bool:
        """Whether the engine has answered since the question: an event from before says nothing about now."""
        return self._loop.observer.heard_since(question.since)

    def check_engine(self, what: str) -> None:
        """Raises Unreachable while the engine does not answer."""
        if silence := self.decision.situation.observed.silence:
            raise Unreachable(what, str(silence), REMEDY)

    @contextlib.contextmanager
    def question(self, names: tuple[str, ...], waits: bool = True) -> Iterator[Question]:
        """Asks for these services while the block runs: every change accepted until now counts, and every file saved
        until now for a caller that waits. The loop runs the probes whose last answers do not count."""
        services = self.catalog.services
        generation = self._loop.generations.changed(manifest=True) if waits else self._loop.generations.latest
        question = Question(names, self._loop.clock(), generation, waits)
        asked = {*names, *closure(services, names)}
        self._loop.questions[question] = {name: question.since_of(services[name]) for name in asked}
        self._loop.observer.ask()
        if waits:
            self._loop.wakes.check_files()
        elif any(services[name].ready or services[name].away for name in asked):
            self._loop.wake()
        try:
            yield question
        finally:
            self._loop.questions.pop(question, None)

    def usage(self) -> dict[str, Any]:
        """CPU seconds and bytes of each running service, and of the machine. Reads files of the kernel."""
        return {
            "at": time.time(),
            "services": {
                n: {"cpu_seconds": round(c, 4), "memory": m} for n, (c, m) in self._loop.running.use().items()
            },
            "machine": machine(),
        }

    def listener(self, port: int) -> dict[str, Any]:
        """The process that listens at a TCP port of this machine. Raises Missing if there is none, or none that rorg
        can see."""
        return {"port": port, **self._process(f"find who listens at port {port}", lambda: listening(port))}

    def connection(self, port: int, to: int) -> dict[str, Any]:
        """The process that has a TCP connection from a port of this machine to another. Raises Missing as above."""
        return {"port": port, **self._process(f"find who called from port {port}", lambda: calling(port, to))}

    def _process(self, what: str, find: Callable[[], int | None]) -> dict[str, Any]:
        """A process, and the service that runs it, if one does. Looks at all sockets, and asks the engine if no service
        is known: a program may call before the loop has seen it run."""
        if not self.engine.local:
            raise Missing(what, "the engine is on another machine")
        forebears = lineage(find())
        if not forebears:
            raise Missing(what, "no known process")
        runs = {s.pid: name for name, s in self.statuses().items() if s.incarnation}
        if not runs.keys() & set(forebears):
            containers = self.engine.list()
            if any(c.brief for c in containers):
                raise Busy(what, "the engine does not report what runs", "again in a moment")
            runs = {c.pid: c.service for c in containers if c.alive}
        return {"pid": forebears[0], "service": next((runs[pid] for pid in forebears if pid in runs), "")}

    # -- changing ----------------------------------------------------------------------------------------------

    def put_request(self, caller: Caller, request: Request) -> Future[int]:
        """Accepts a request whole, in place of the one with the same requester and id, or refuses it whole."""
        allow_request(caller, request.requester, request.services, self.catalog, request.priority)
        change = put_request(self.current, request)

        def edit(document: RequestsDocument) -> RequestsDocument:
            after = change.edit(document)
            # Under the lock of the file, so that no pass drops the renewed request meanwhile.
            self._loop.leases.note(request.key)
            return after

        return self.change(caller, replace(change, edit=edit))

    def renew(self, caller: Caller, key: tuple[str, str]) -> dict[str, Any]:
        """Renews a lease for its full time, in memory only: a restart of rorg renews all leases. A service's lease ends
        once its manifest would no longer allow the same request."""
        catalog = self.catalog
        allow_request(caller, key[0], (), catalog)
        request = self._loop.leases.renew(
            key, self.committer.file, lambda r: allow_request(caller, r.requester, r.services, catalog, r.priority)
        )
        if request is None:
            raise Missing(f"renew '{key[1]}'", f"{key[0]} has no request of that id", "to request it again")
        return request_json(request)

    def fetch(self, seconds: float) -> tuple[int, dict[str, Any]]:
        """Fetches the repository, and waits this long: (generation of the result, state of the repository). Raises
        Refused if rorg follows no repository."""
        source = self.tree.source
        if source is None:
            raise Refused("fetch", "no repository is followed", "`rorg run --git REPO`")
        source.fetch(seconds)
        return self.changed(manifest=True), source.as_json()

    def withheld(self, kind: str, name: str) -> bool:
        """Whether the removal of this Service or Group waits for confirmation."""
        decision = self.decision
        former = decision.memory.kept.former.get(name)
        known = "Group" if former is not None and isinstance(former.what, Group) else "Service"
        return kind == known and name in decision.situation.withheld

    def change(self, caller: Caller, change: Change) -> Future[int]:
        """Applies a change of the requests file. The future is done, with its generation, when it is on the disk."""
        changed: list[bool] = []

        def note(document: RequestsDocument) -> RequestsDocument:
            after = change.edit(document)
            changed.append(after != document)
            return after

        def told(future: Future[int]) -> None:
            # Only when it is on the disk, and only if it changed anything.
            if future.exception() is None and any(changed):
                text = f"{change.message} (by {caller.author})"
                self.recorder.event(change.kind, text, caller.person, author=caller.author, **change.about)

        future = self.committer.submit(note, caller.identity)
        future.add_done_callback(told)
        return future
