"""What a robot is asked for, as a value: the content of the requests file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from rorg.model.catalog import Hold, Request


@dataclass(frozen=True, slots=True)
class RequestsDocument:
    """The content of the file."""

    requests: tuple[Request, ...] = ()
    restarts: Mapping[str, str] = field(default_factory=dict)
    """Service -> when its restart was asked for, ISO 8601 in UTC."""
    holds: Mapping[str, Hold] = field(default_factory=dict)
    """Service -> until when it must not be active."""
    suspended: Hold | None = None
    removals: tuple[str, ...] = ()
    """What is not declared any more, and confirmed to be removed."""
    down: bool = False
    """The robot is taken down: everything is ceased and removed, and then rorg ends."""
    down_since: str = ""
    """When all of it was gone, ISO 8601 in UTC; empty before. From then on it stays down until somebody runs it."""
    purge: bool = False
    """Volumes of the robot go with it, with all that is in them."""
    retries: Mapping[str, str] = field(default_factory=dict)
    """Service -> when it was asked for that what failed of it be tried again, as `restarts`."""

    def put(self, request: Request) -> RequestsDocument:
        """With this request, in place of the one with the same requester and id."""
        if all(r.key != request.key for r in self.requests):
            return replace(self, requests=(*self.requests, request))
        # In its place: who came first is served first, however often it is renewed.
        return replace(self, requests=tuple(request if r.key == request.key else r for r in self.requests))

    def up(self) -> RequestsDocument:
        """Of a robot that is not down any more."""
        return replace(self, down=False, down_since="", purge=False)

    def without(self, keys: set[tuple[str, str]]) -> RequestsDocument:
        return replace(self, requests=tuple(r for r in self.requests if r.key not in keys))
