"""Operations where no rorg serves."""

from __future__ import annotations

import contextlib
import time
from functools import cached_property
from typing import Any

from rorg.api import changes, views
from rorg.api.body_models import HoldsBody, PutRequest, RetryBody, SuspendBody
from rorg.api.changes import Change
from rorg.api.current import Current
from rorg.api.inputs import read, request_of, seconds_of
from rorg.cli.context import Context
from rorg.cli.local import decision, glance
from rorg.cli.places import nobody
from rorg.cli.published import hopeless, unready
from rorg.core.decide import Decision
from rorg.core.status import statuses
from rorg.daemon.snapshot import request_json
from rorg.errors import NotReady, RorgError
from rorg.host.clock import wall_clock
from rorg.model.graph import closure


class Local:
    """Operations where no rorg serves: they are written down for the next one, by the rules of the running one."""

    def __init__(self, context: Context) -> None:
        self.context = context
        self._asked: tuple[str, str] | None = None
        """(requester, id) of what was requested last."""

    @cached_property
    def current(self) -> Current:
        """As one pass sees it, without probing: whether something is ready changes nothing of what may be asked. Where
        the engine does not answer nothing is known of what runs, as in a pass of the loop."""
        return _current(glance(self.context, self.context.catalog()))

    def put_request(self, id: str, requester: str, body: dict[str, Any]) -> None:
        renewed = wall_clock() if body.get("ttl") else ""
        request = request_of(id, requester, read(PutRequest, body), renewed)
        self._do(changes.put_request(self.current, request))
        self._asked = request.key

    def requesters(self, id: str) -> list[str]:
        return [r.requester for r in self.context.document().requests if r.id == id]

    def request(self, id: str, requester: str) -> dict[str, Any] | None:
        found = next((r for r in self.context.document().requests if r.key == (requester, id)), None)
        return request_json(found) if found else None

    def release(self, id: str, requester: str, force: bool = True) -> None:
        current = None
        if not force:
            with contextlib.suppress(RorgError):  # a request can be given up though nobody knows what runs
                current = self.current
        self._do(changes.release((requester, id), current))

    def restart(self, name: str, force: bool) -> list[str]:
        return self._do(changes.restart(self.current, name, force, time.time()))

    def retry(self, names: list[str], force: bool) -> list[str]:
        asked = read(RetryBody, {"services": names})
        return self._do(changes.retry(self.current, asked.services, time.time(), force))

    def hold(self, body: dict[str, Any]) -> list[str]:
        asked = read(HoldsBody, body)
        seconds = seconds_of(asked.duration, "duration")
        return self._do(changes.hold(self.current, asked.services, seconds, asked.reason, time.time(), asked.force))

    def suspend(self, body: dict[str, Any] | None) -> None:
        asked = read(SuspendBody, body) if body else None
        seconds = seconds_of(asked.duration, "duration") if asked else None
        self._do(changes.suspend(seconds, asked.reason if asked else "", time.time()))

    @cached_property
    def looked(self) -> Current:
        """As one pass sees it, with one look at each probe."""
        return _current(decision(self.context, self.context.catalog()))

    def why(self, name: str) -> list[Any]:
        return views.why(self.looked, name)

    def waiting(self, what: str) -> None:
        if self.context.state.owner() is None:
            raise nobody(what, self.context.state)

    def wait(self, names: list[str], timeout: float) -> None:
        """By what the rorg that owns the robot publishes."""
        what = ", ".join(names)
        self.waiting(f"wait for {what}")
        current, catalog = self.current, self.current.catalog
        asked = [m for s in names for m in current.members(s)]
        closed = [*asked, *sorted(closure(catalog.services, asked) - set(asked))]

        def done(view: dict[str, Any]) -> str:
            known = self._asked is None or any((r["requester"], r["id"]) == self._asked for r in view["requests"])
            failed = hopeless(view, closed) if known else {}
            if failed:
                told = "; ".join(f"{name}: {why}" for name, why in failed.items())
                raise NotReady(f"wait for {what}", told, "`rorg why` for the reasons")
            return unready(view, closed) if known else "the request has not been read yet"

        self.context.wait(what, done, timeout)

    def _do(self, change: Change) -> list[str]:
        self.context.change(change.edit)
        return list(change.services)


def _current(found: Decision) -> Current:
    return Current(found, statuses(found.situation, found.plan, found.holds), found.situation.now)
