"""What the API offers, with no HTTP in it: the running loop as its callers may see and change it."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import replace
from typing import Any

from rorg.api import changes, views
from rorg.api.changes import Change
from rorg.api.current import Current, missing
from rorg.api.permissions import Caller, allow_request, allow_restart
from rorg.api.readiness import Question, Readiness, readiness
from rorg.core.decide import Decision
from rorg.core.desired import Desired
from rorg.core.preview import preview
from rorg.core.status import Status, statuses
from rorg.daemon.loop import Loop
from rorg.daemon.snapshot import about_tree, request_json, snapshot
from rorg.engines.observe import REMEDY
from rorg.errors import Busy, Missing, Refused, Unreachable
from rorg.host.listeners import calling, lineage, listening
from rorg.host.load import machine
from rorg.model.catalog import Catalog, Group, Request
from rorg.model.graph import closure
from rorg.store.committer import Committer
from rorg.store.requests_document import RequestsDocument
from rorg.store.requests_file import RequestsFile


class Operations:
    """Reads come from the last decision of the loop; changes go through the committer, and are durable when their
    future is done. Every method returns at once."""

    def __init__(self, loop: Loop) -> None:
        self.loop = loop
        self.committer = Committer(RequestsFile(loop.leases.file.path), self.changed)
        self.ending = False
        """rorg is being stopped: nothing is answered any more, and nothing accepted."""
        self._cached: tuple[Decision | None, dict[str, Status], dict[str, bytes]] = (None, {}, {})

    # -- reading -----------------------------------------------------------------------------------------------

    @property
    def decision(self) -> Decision:
        """Of the last pass over a tree that has been read. Raises Busy before there is one."""
        found = self.loop.decision
        # The tree may have been read since: what a pass from before that does not know may well be declared.
        if found is None or not (found.situation.desired.catalog.fingerprint or self.loop.tree.errors):
            raise Busy("answer", "rorg has just begun and has not read its manifests yet", "again in a moment")
        return found

    def changed(self, news: bool = True, manifest: bool = False) -> int:
        """Generation of a change that is on the disk now; without news, of the last one."""
        generations = self.loop.generations
        generation = generations.changed(manifest) if news else generations.latest
        self.loop.wake()
        return generation

    def open_to(self, generation: int) -> bool:
        """Whether an answer may be given to somebody who knows of this generation. Raises Busy when there will be
        none."""
        if self.ending:
            raise Busy("answer", "rorg is being stopped", "again in a moment")
        return self.loop.generations.reached(generation)

    @property
    def catalog(self) -> Catalog:
        return self.decision.situation.desired.catalog

    def statuses(self) -> dict[str, Status]:
        """Of all declared services; computed once a decision."""
        decision = self.decision
        if self._cached[0] is not decision:
            self._cached = (decision, statuses(decision.situation, decision.plan, decision.holds), {})
        return self._cached[1]

    def service_text(self, name: str) -> bytes:
        """The JSON of one service."""
        found = self.statuses()
        if name not in found:
            raise missing(name, set(found))
        texts = self._cached[2]
        if name not in texts:
            texts[name] = json.dumps(found[name].as_json()).encode()
        return texts[name]

    @property
    def at_rest(self) -> bool:
        """Whether nothing is to be done, nothing under way, and no service still to be seen to come up."""
        decision = self.decision
        if decision.plan.actions or decision.memory.in_flight or not decision.situation.observed.complete:
            return False
        return not any(
            s.health == "Progressing" or s.condition("Updated").reason == "OnTrial" for s in self.statuses().values()
        )

    @property
    def current(self) -> Current:
        return Current(self.decision, self.statuses(), self.loop.clock())

    def members(self, name: str) -> tuple[str, ...]:
        """The services that a name stands for. Raises Missing."""
        return self.current.members(name)

    def runs(self, name: str) -> bool:
        """Whether its container is seen to be alive; a meta-service always is."""
        return self.current.runs(name)

    def snapshot(self) -> dict[str, Any]:
        return snapshot(
            self.decision, {**self.loop.publisher.about, **about_tree(self.loop.tree, self.loop.leases.file)}
        )

    def suppose(self, desired: Desired) -> Decision:
        """What would be decided if this were declared."""
        decision, inputs = self.decision, self.loop.inputs
        assert inputs is not None, "there is one with each decision"
        return preview(inputs, decision.memory, desired)

    def requests(self) -> list[dict[str, Any]]:
        """All requests, with the seconds that are left of their leases."""
        return views.requests(self.current)

    def why(self, name: str) -> list[dict[str, Any]]:
        """Why a service, or each of a group, is active, or why not. Raises Missing."""
        return views.why(self.current, name)

    def readiness(self, question: Question) -> Readiness:
        """How far the services of a question, and all that they need, are."""
        return readiness(self.decision, self.statuses(), question)

    def heard_since(self, question: Question) -> bool:
        """Whether the engine has answered since somebody asked: what an event told before says nothing of now."""
        return self.loop.observer.heard_since(question.since)

    def check_engine(self, what: str) -> None:
        """Raises Unreachable while the engine does not answer."""
        if silence := self.decision.situation.observed.silence:
            raise Unreachable(what, str(silence), REMEDY)

    @contextlib.contextmanager
    def question(self, names: tuple[str, ...], waits: bool = True) -> Iterator[Question]:
        """While the block runs somebody asks for these services: every change accepted until now counts, and the loop
        asks their probes again, as far as their last answers do not count."""
        services = self.catalog.services
        question = Question(names, self.loop.clock(), self.loop.generations.latest, waits)
        asked = {*names, *closure(services, names)}
        self.loop.questions[question] = {name: question.since_of(services[name]) for name in asked}
        self.loop.observer.ask()
        if any(services[name].ready for name in asked):
            self.loop.wake()
        try:
            yield question
        finally:
            self.loop.questions.pop(question, None)

    def usage(self) -> dict[str, Any]:
        """CPU seconds and bytes of each service that runs, and of the machine. Reads files of the kernel."""
        return {
            "at": time.time(),
            "services": {n: {"cpu_seconds": round(c, 4), "memory": m} for n, (c, m) in self.loop.use().items()},
            "machine": machine(),
        }

    def listener(self, port: int) -> dict[str, Any]:
        """The process that listens at a TCP port of this machine. Raises Missing where there is none to be seen."""
        return {"port": port, **self._process(f"find who listens at port {port}", lambda: listening(port))}

    def connection(self, port: int, to: int) -> dict[str, Any]:
        """The process that has a TCP connection from a port of this machine to another. Raises Missing as above."""
        return {"port": port, **self._process(f"find who called from port {port}", lambda: calling(port, to))}

    def _process(self, what: str, find: Callable[[], int | None]) -> dict[str, Any]:
        """A process and the service that runs it, if one does. Looks at all sockets, and asks the engine where nobody
        is known: a program may call before the loop has seen it run."""
        if not self.loop.engine.local:
            raise Missing(what, "the engine is on another machine")
        forebears = lineage(find())
        if not forebears:
            raise Missing(what, "no known process does")
        runs = {s.pid: name for name, s in self.statuses().items() if s.incarnation}
        if not runs.keys() & set(forebears):
            containers = self.loop.engine.list()
            if any(c.brief for c in containers):
                raise Busy(what, "the engine does not tell what runs", "again in a moment")
            runs = {c.pid: c.service for c in containers if c.alive}
        return {"pid": forebears[0], "service": next((runs[pid] for pid in forebears if pid in runs), "")}

    # -- changing ----------------------------------------------------------------------------------------------

    def put_request(self, caller: Caller, request: Request) -> Future[int]:
        """Accepts it whole, in place of the one with the same requester and id, or refuses it whole."""
        allow_request(caller, request.requester, request.services, self.catalog, request.priority)
        change = changes.put_request(self.current, request)

        def edit(document: RequestsDocument) -> RequestsDocument:
            after = change.edit(document)
            # Under the lock of the file, so that no pass drops meanwhile what is renewed by this.
            self.loop.leases.note(request.key)
            return after

        return self._change(caller, replace(change, edit=edit))

    def renew(self, caller: Caller, key: tuple[str, str]) -> dict[str, Any]:
        """Gives a lease its full time again. In memory alone: a restart of rorg does so for all. A service's runs out
        once its manifest would not let it request the same."""
        catalog = self.catalog
        allow_request(caller, key[0], (), catalog)
        found = self.loop.leases.renew(
            key, self.committer.file, lambda r: allow_request(caller, r.requester, r.services, catalog, r.priority)
        )
        if found is None:
            raise Missing(f"renew '{key[1]}'", f"{key[0]} has no request of that id", "requesting again")
        return request_json(found)

    def release(self, caller: Caller, key: tuple[str, str], force: bool) -> Future[int]:
        """Gives a request up; what is released already is fine."""
        allow_request(caller, key[0], (), self.catalog)
        return self._change(caller, changes.release(key, None if force else self.current))

    def restart(self, caller: Caller, name: str, force: bool) -> tuple[tuple[str, ...], Future[int]]:
        """(names of what is restarted, the change)."""
        allow_restart(caller, name, self.catalog)
        change = changes.restart(self.current, name, force, time.time())
        return change.services, self._change(caller, change)

    def retry(self, caller: Caller, names: Sequence[str], force: bool) -> tuple[tuple[str, ...], Future[int]]:
        """(Names of what is tried again, the change)."""
        change = changes.retry(self.current, names, time.time(), force)
        return change.services, self._change(caller, change)

    def hold(
        self, caller: Caller, names: Sequence[str], seconds: float | None, reason: str, force: bool = False
    ) -> tuple[tuple[str, ...], Future[int]]:
        """Holds services and groups, all or none, for so long; None ends it. (Names of what is held, the change.)"""
        change = changes.hold(self.current, names, seconds, reason, time.time(), force)
        return change.services, self._change(caller, change)

    def suspend(self, caller: Caller, seconds: float | None, reason: str) -> Future[int]:
        return self._change(caller, changes.suspend(seconds, reason, time.time()))

    def confirm(self, caller: Caller, names: tuple[str, ...]) -> Future[int]:
        """Lets go of what is withheld: exactly these, and for as long as they are not declared again."""
        return self._change(caller, changes.confirm(self.current, names))

    def fetch(self, seconds: float) -> tuple[int, dict[str, Any]]:
        """Fetches what is followed, and waits so long for that: (generation of what came of it, how it is). Raises
        Refused where nothing is followed."""
        source = self.loop.tree.source
        if source is None:
            raise Refused("fetch", "no repository is followed", "`rorg run --git REPO`")
        source.fetch(seconds)
        return self.changed(manifest=True), source.as_json()

    def down(self, caller: Caller, keep_requests: bool, volumes: bool) -> Future[int]:
        """Takes the robot down; then rorg ends."""
        return self._change(caller, changes.down(keep_requests, volumes, self.decision.situation.suspended))

    def up(self, caller: Caller) -> Future[int]:
        """Brings the robot up that was taken down."""
        return self._change(caller, changes.up())

    def withheld(self, kind: str, name: str) -> bool:
        """Whether the removal of this Service or Group waits for a person's word."""
        decision = self.decision
        former = decision.memory.kept.former.get(name)
        known = "Group" if former is not None and isinstance(former.what, Group) else "Service"
        return kind == known and name in decision.situation.withheld

    def _change(self, caller: Caller, change: Change) -> Future[int]:
        changed: list[bool] = []

        def note(document: RequestsDocument) -> RequestsDocument:
            after = change.edit(document)
            changed.append(after != document)
            return after

        def told(future: Future[int]) -> None:
            # Once the disk has it, and only when it changed anything.
            if future.exception() is None and any(changed):
                text = f"{change.message} (by {caller.author})"
                self.loop.recorder.event(change.kind, text, caller.person, author=caller.author, **change.about)

        future = self.committer.submit(note, caller.identity)
        future.add_done_callback(told)
        return future
