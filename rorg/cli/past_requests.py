"""What people had requested at an earlier time, and the changes that restore that. Requests with a lease are left to
the programs that renew them, and those of services to the services."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path

from rorg.cli.context import Context
from rorg.cli.operations import operating
from rorg.cli.terminal import printable
from rorg.core.wanted import wanted
from rorg.errors import Refused
from rorg.history.database import reading
from rorg.history.meta_requests import Asked
from rorg.manifest.load import load
from rorg.model.catalog import DEVELOPER, Catalog, Request

Key = tuple[str, str]


class EarlierRequests:
    """The requests of meta-services at a time (ISO 8601 in UTC)."""

    def __init__(self, context: Context, root: Path, at: str) -> None:
        self.context, self.root = context, root
        if not context.state.readable:
            why = f"the record of requests is in {context.state.path}, which this user may not read"
            raise Refused("restore requests", why, "as root, or `rorg rollback` for the manifests alone")
        with reading(context.state.journal) as database:
            self.then = {r.key: r for r in Asked(database).at(at) if r.ttl is None}

    @cached_property
    def _now(self) -> dict[Key, Request]:
        """The current requests of the same requesters."""
        catalog = load(self.root).catalog
        metas = {name for name, service in catalog.services.items() if service.meta} if catalog else set()
        known = {DEVELOPER, *metas, *(requester for requester, _ in self.then)}
        return {r.key: r for r in self.context.document().requests if r.requester in known and r.ttl is None}

    @property
    def _released(self) -> list[Request]:
        return [request for key, request in self._now.items() if key not in self.then]

    @property
    def _requested(self) -> list[Request]:
        return [request for key, request in self.then.items() if _content(request) != _content(self._now.get(key))]

    def lines(self) -> list[str]:
        """What would be requested and released, for people."""
        changes = [("-", request) for request in self._released] + [("+", request) for request in self._requested]
        return [printable(f"{sign} request '{r.id}' of {r.requester}: {', '.join(r.services)}") for sign, r in changes]

    def effects(self, catalog: Catalog) -> list[str]:
        """Which services these changes start and end under manifests, for people. Drivers are marked."""
        present = self.context.document()
        past = present.without({r.key for r in self._released})
        for request in self._requested:
            past = past.put(request)
        now, then = (wanted(catalog, (*catalog.requests, *document.requests)) for document in (present, past))
        sorts = ("to start", then.keys() - now.keys()), ("to end", now.keys() - then.keys())
        marked = lambda name: f"{name} (moves hardware)" if catalog.services[name].driver else name  # noqa: E731
        return [
            printable(f"{what} because of these requests: {', '.join(map(marked, sorted(of)))}")
            for what, of in sorts
            if of
        ]

    def restore(self) -> None:
        """Requests and releases, through the running rorg or without one."""
        if not self.lines():
            return
        robot = operating(self.context)
        for r in self._requested:
            body = {"services": list(r.services), "reason": r.reason, "priority": r.priority, "ttl": None}
            robot.put_request(r.id, r.requester, body)
        for r in self._released:
            robot.release(r.id, r.requester)


def _content(request: Request | None) -> tuple[object, ...] | None:
    """What a request asks for."""
    return (request.services, request.reason, request.priority) if request else None
