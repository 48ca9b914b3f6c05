"""Operations if no rorg serves: they are written to the requests file for the next one, by the same rules.

The counterpart with a running rorg is `Served` in operations.py; both have the same methods.
"""

from __future__ import annotations

import contextlib
import time
from dataclasses import replace
from functools import cached_property
from typing import Any

from rorg.api import changes
from rorg.api.changes import Change
from rorg.api.current import Current
from rorg.api.inputs import PutRequest, SuspendBody, read, request_of, seconds_of
from rorg.api.why import why_active
from rorg.cli.context import Context
from rorg.cli.local import decision, glance
from rorg.cli.places import nobody
from rorg.cli.published import failure, hopeless, unready
from rorg.core.decide import Decision
from rorg.core.status import Statuses
from rorg.daemon.snapshot import request_json
from rorg.errors import NotReady, RorgError
from rorg.host.clock import moment, wall_clock
from rorg.host.git import head
from rorg.model.graph import closure


class Local:
    """What commands ask of a robot, done by this process. Bodies are those of the API."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self._asked: tuple[str, str] | None = None
        """(requester, id) of the last request."""

    @cached_property
    def current(self) -> Current:
        """The robot as one pass sees it, without probes: they do not affect what may be requested. If the engine does
        not answer, nothing is known of what runs, as in a pass of the loop."""
        return _current(glance(self.context, self.context.catalog()))

    @cached_property
    def looked(self) -> Current:
        """The robot as one pass sees it that asks each probe once."""
        current = _current(decision(self.context, self.context.catalog()))
        return replace(current, in_git=head(self.context.root) is not None)

    def put_request(self, id: str, requester: str, body: dict[str, Any]) -> None:
        renewed = wall_clock() if body.get("ttl") else ""
        request = request_of(id, requester, read(PutRequest, body), renewed)
        self._do(changes.put_request(self.current, request))
        self._asked = request.key

    def requests(self, id: str) -> list[dict[str, Any]]:
        return [request_json(r) for r in self.context.document().requests if r.id == id]

    def release(self, id: str, requester: str, force: bool = True) -> None:
        current = None
        if not force:
            with contextlib.suppress(RorgError):  # releasing must work although it is unknown what runs
                current = self.current
        self._do(changes.release((requester, id), current))

    def restart(self, name: str, force: bool) -> list[str]:
        return self._do(changes.restart(self.current, name, force, time.time()))

    def change(self, call: str, body: dict[str, Any], force: bool) -> list[str]:
        operation = changes.OPERATIONS[call]
        read_body = read(operation.body, {**body, "force": force})
        return self._do(operation.change(self.current, read_body, moment()))

    def suspend(self, body: dict[str, Any] | None) -> None:
        asked = read(SuspendBody, body) if body else None
        seconds = seconds_of(asked.duration, "duration") if asked else None
        self._do(changes.suspend(seconds, asked.reason if asked else "", moment()))

    def locked(self) -> dict[str, str]:
        """None: the next rorg will ask them."""
        return {}

    def why(self, name: str) -> list[Any]:
        return why_active(self.looked, name)

    def check_wait(self, what: str) -> None:
        if self.context.state.owner() is None:
            raise nobody(what, self.context.state)

    def wait(self, names: list[str], timeout: float) -> None:
        """Reads what the rorg that owns the robot publishes."""
        what = ", ".join(names)
        self.check_wait(f"wait for {what}")
        current, catalog = self.current, self.current.catalog
        asked = [m for s in names for m in current.members(s)]
        closed = [*asked, *sorted(closure(catalog.services, asked) - set(asked))]

        def done(view: dict[str, Any]) -> str:
            if self._asked and not any((r["requester"], r["id"]) == self._asked for r in view["requests"]):
                return "the request has not been read yet"
            if failed := hopeless(view, closed):
                raise NotReady(f"wait for {what}", failure(failed), "`rorg why` for the reasons")
            return unready(view, closed)

        self.context.wait(what, done, timeout)

    def _do(self, change: Change) -> list[str]:
        self.context.change(change.edit)
        return list(change.services)


def _current(decision: Decision) -> Current:
    return Current(decision, Statuses(decision.situation, decision.plan, decision.holds), decision.situation.now)
