"""What the API offers, with no HTTP in it: the running loop as its callers may see and change it."""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from dataclasses import replace
from typing import Any

from rorg.api.permissions import Caller, allow_request, allow_restart
from rorg.api.readiness import Question, Readiness, readiness
from rorg.core.decide import Decision
from rorg.core.requests import problems
from rorg.core.status import Status, statuses
from rorg.daemon.loop import Loop
from rorg.daemon.snapshot import about_tree, request_json, snapshot
from rorg.errors import Busy, Invalid, Missing, Refused
from rorg.host.clock import wall_clock
from rorg.host.listeners import lineage, listening
from rorg.host.load import machine
from rorg.model.catalog import Catalog, Hold, Request, Service
from rorg.model.diagnostics import nearest
from rorg.model.graph import closure
from rorg.model.units import format_seconds
from rorg.store.committer import Committer
from rorg.store.requests_document import RequestsDocument
from rorg.store.requests_file import RequestsFile

MOST_REQUESTS = 100
"""Requests that one requester may have at a time."""


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
        tree = self.loop.tree
        if self.loop.decision is None or not (tree.loaded or tree.errors):
            raise Busy("answer", "rorg has just begun and has not read its manifests yet", "again in a moment")
        return self.loop.decision

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
            raise Missing(f"find the service '{name}'", "there is none of that name", nearest(name, found))
        texts = self._cached[2]
        if name not in texts:
            texts[name] = json.dumps(found[name].as_json()).encode()
        return texts[name]

    def members(self, name: str) -> tuple[str, ...]:
        found = self.catalog.members(name)
        if not found:
            known = {*self.catalog.services, *self.catalog.groups}
            raise Missing(f"find the service '{name}'", "there is none of that name", nearest(name, known))
        return found

    def containers_of(self, names: tuple[str, ...]) -> list[Service]:
        """Those of the named services that have containers."""
        return [s for n in names if not (s := self.catalog.services[n]).meta]

    def snapshot(self) -> dict[str, Any]:
        return snapshot(
            self.decision, {**self.loop.publisher.about, **about_tree(self.loop.tree, self.loop.leases.file)}
        )

    def requests(self) -> list[dict[str, Any]]:
        """All requests, with the seconds that are left of their leases."""
        decision, now = self.decision, self.loop.clock()
        leases = decision.memory.leases
        return [
            {**request_json(r), "expires_in": round(leases[r.key].until - now, 3) if r.key in leases else None}
            for r in (*self.catalog.requests, *decision.settled.requests)
        ]

    def why(self, name: str) -> dict[str, Any]:
        """The chain from a root to a service, who requests it, and what it waits for."""
        status = self.statuses()[name]
        message = next((c.message for c in status.conditions if c.type == "Requested"), "")
        return {
            "service": name,
            "wanted": status.wanted,
            "state": status.state,
            "chain": message.split(" <- ") if status.wanted else [],
            "requests": [r for r in self.requests() if any(name in self.catalog.members(s) for s in r["services"])],
            "waits": [w.reason for w in self.decision.plan.waitings if w.service == name],
        }

    def readiness(self, question: Question) -> Readiness:
        """How far the services of a question, and all that they need, are."""
        return readiness(self.decision, self.statuses(), question)

    @contextlib.contextmanager
    def question(self, names: tuple[str, ...]) -> Iterator[Question]:
        """While the block runs somebody waits for these services: every change accepted until now counts, and probes
        are asked anew."""
        question, services = Question(names, self.loop.clock(), self.loop.generations.latest), self.catalog.services
        asked = tuple({*names, *closure(services, names)})
        self.loop.questions[question] = asked, question.since
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

    def listener(self, port: int) -> str:
        """The service one of whose processes listens at a TCP port of this machine. Looks at all sockets, and asks the
        engine where nobody is known: a program may call before the loop has seen it run."""
        forebears = lineage(listening(port))
        runs = {s.pid: name for name, s in self.statuses().items() if s.incarnation}
        if forebears and not runs.keys() & set(forebears):
            containers = self.loop.engine.list()
            if any(c.brief for c in containers):
                raise Busy(f"find who listens at port {port}", "the engine holds back what runs", "again in a moment")
            runs = {c.pid: c.service for c in containers if c.alive}
        found = next((runs[pid] for pid in forebears if pid in runs), None)
        if found is None:
            raise Missing(f"find who listens at port {port}", "no service's process is known to")
        return found

    # -- changing ----------------------------------------------------------------------------------------------

    def put_request(self, caller: Caller, request: Request) -> Future[int]:
        """Accepts it whole, in place of the one with the same requester and id, or refuses it whole."""
        catalog = self.catalog
        allow_request(caller, request.requester, request.services, catalog)
        request = replace(request, incarnation=self._incarnation(request.requester))

        def edit(document: RequestsDocument) -> RequestsDocument:
            found = problems(catalog, document.requests, request)
            if found:
                cause, remedy = found[0]
                kind = Refused if "conflict" in cause or "does not fit" in cause else Invalid
                raise kind(f"request {', '.join(request.services)}", "; ".join(c for c, _ in found), remedy)
            own = [r for r in document.requests if r.requester == request.requester and r.id != request.id]
            if len(own) >= MOST_REQUESTS:
                raise Refused(
                    f"accept another request of {request.requester}", f"it has {len(own)} already", "to release some"
                )
            return document.put(request)

        self.loop.leases.note(request.key)
        return self._change(
            caller,
            edit,
            "request",
            f"request '{request.id}' of {request.requester}: {', '.join(request.services)}",
            service=request.requester,
        )

    def runs(self, name: str) -> bool:
        """Whether its container is seen to be alive; a meta-service always is."""
        status = self.statuses().get(name)
        return status is not None and (status.state == "meta" or bool(status.incarnation))

    def _incarnation(self, requester: str) -> str | None:
        """The run of the requester that a request belongs to; None for those that have no container."""
        service = self.catalog.services.get(requester)
        if service is None or service.meta:
            return None
        if not self.decision.situation.observed.complete:
            raise Busy(f"request as {requester}", "the engine has not told yet what runs", "again in a moment")
        if not self.runs(requester):
            raise Refused(
                f"request as {requester}",
                f"{requester} does not run, and a request belongs to a run of its requester",
                "to request it first",
            )
        return self.statuses()[requester].incarnation

    def renew(self, caller: Caller, key: tuple[str, str]) -> dict[str, Any]:
        """Gives a lease its full time again. In memory alone: a restart of rorg does so for all."""
        allow_request(caller, key[0], (), self.catalog)
        found = self.loop.leases.renew(key, self.committer.file)
        if found is None:
            raise Missing(f"renew '{key[1]}'", f"{key[0]} has no request of that id", "to request again")
        return request_json(found)

    def release(self, caller: Caller, key: tuple[str, str]) -> Future[int]:
        """Gives a request up; what is released already is fine."""
        allow_request(caller, key[0], (), self.catalog)
        return self._change(
            caller,
            lambda document: document.without({key}),
            "release",
            f"request '{key[1]}' of {key[0]} released",
            service=key[0],
        )

    def restart(self, caller: Caller, name: str, force: bool) -> Future[int]:
        allow_restart(caller, name, self.catalog)
        names = [s.name for s in self.containers_of(self.members(name))]
        if not names:
            raise Invalid(f"restart {name}", "a meta-service has no container", "the services that it requests")
        drivers = [n for n in names if self.catalog.services[n].driver]
        if drivers and not force:
            raise Refused(f"restart {name}", f"{', '.join(drivers)} moves hardware", "to say force")
        if not any(self.statuses()[n].wanted for n in names):
            raise Refused(
                f"restart {name}", "nobody active requests it, so there is nothing to restart", f"`rorg request {name}`"
            )
        at = wall_clock()
        return self._change(
            caller,
            lambda document: replace(document, restarts={**document.restarts, **dict.fromkeys(names, at)}),
            "restart",
            f"restart of {', '.join(names)}",
            services=names,
        )

    def hold(self, caller: Caller, name: str, seconds: float | None, reason: str) -> Future[int]:
        """Holds a service, or a group's, for so long; None ends it."""
        names = [s.name for s in self.containers_of(self.members(name))]
        if not names:
            raise Invalid(f"hold {name}", "a meta-service has no container that could be ceased")
        now = time.time()

        def edit(document: RequestsDocument) -> RequestsDocument:
            kept = {n: h for n, h in document.holds.items() if h.until > now and n not in names}
            more = {} if seconds is None else dict.fromkeys(names, Hold(now + seconds, reason))
            return replace(document, holds={**kept, **more})

        told = "no longer held" if seconds is None else f"held for {format_seconds(seconds)}: {reason}"
        return self._change(caller, edit, "hold", f"{', '.join(names)} {told}", services=names)

    def suspend(self, caller: Caller, seconds: float | None, reason: str) -> Future[int]:
        hold = None if seconds is None else Hold(time.time() + seconds, reason)
        told = "no longer suspended" if seconds is None else f"suspended for {format_seconds(seconds)}: {reason}"
        return self._change(caller, lambda document: replace(document, suspended=hold), "suspend", told)

    def confirm(self, caller: Caller, names: tuple[str, ...]) -> Future[int]:
        """Lets go of what is withheld: exactly these, and for as long as they are not declared again."""
        withheld = self.decision.situation.withheld
        others = [n for n in names if n not in withheld]
        if others:
            raise Refused(
                f"confirm the removal of {', '.join(others)}", "it is not withheld", "`rorg diff` for what is"
            )
        return self._change(
            caller,
            lambda document: replace(document, removals=tuple(dict.fromkeys((*document.removals, *names)))),
            "removal",
            f"removal of {', '.join(names)} confirmed",
            services=list(names),
        )

    def _change(
        self, caller: Caller, edit: Callable[[RequestsDocument], RequestsDocument], kind: str, message: str, **more: Any
    ) -> Future[int]:
        changed: list[bool] = []

        def note(document: RequestsDocument) -> RequestsDocument:
            after = edit(document)
            changed.append(after != document)
            return after

        def tell(done: Future[int]) -> None:
            """Once the disk has it, by whom, and only when it changed anything."""
            if done.exception() is None and any(changed):
                self.loop.recorder.event(kind, f"{message} (by {caller.author})", author=caller.author, **more)

        future = self.committer.submit(note)
        future.add_done_callback(tell)
        return future
