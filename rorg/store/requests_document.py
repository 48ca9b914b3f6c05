"""The content of the requests file, as a value: what a robot is asked to run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from rorg.model.catalog import Hold, Request


@dataclass(frozen=True, slots=True)
class RequestsDocument:
    """The content of the file."""

    requests: tuple[Request, ...] = ()
    restarts: Mapping[str, str] = field(default_factory=dict)
    """Service -> when its restart was requested, ISO 8601 in UTC."""
    holds: Mapping[str, Hold] = field(default_factory=dict)
    """Service -> until when it must not be active."""
    suspended: Hold | None = None
    removals: tuple[str, ...] = ()
    """Undeclared services, networks and volumes whose removal is confirmed."""
    down: bool = False
    """The robot is taken down: everything is stopped and removed, then rorg ends."""
    down_since: str = ""
    """When everything was gone, ISO 8601 in UTC; empty before. From then on it stays down until a person runs it."""
    purge: bool = False
    """The robot's volumes are removed too, with all data."""
    forget: bool = False
    """The robot's history is removed too."""
    retries: Mapping[str, str] = field(default_factory=dict)
    """Service -> when another try of its failed change was requested, as `restarts`."""

    def put(self, request: Request) -> RequestsDocument:
        """With this request, which replaces the one with the same requester and id."""
        if all(r.key != request.key for r in self.requests):
            return replace(self, requests=(*self.requests, request))
        # In its old place: the first request is served first, however often it is renewed.
        return replace(self, requests=tuple(request if r.key == request.key else r for r in self.requests))

    def up(self) -> RequestsDocument:
        """As of a robot that is no longer down."""
        return replace(self, down=False, down_since="", purge=False, forget=False)

    def without(self, keys: set[tuple[str, str]]) -> RequestsDocument:
        return replace(self, requests=tuple(r for r in self.requests if r.key not in keys))
