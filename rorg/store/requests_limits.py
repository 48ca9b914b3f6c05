"""Limits of requests, so that every accepted one can be read back, quickly. A service with the most requests takes no
room from people, and from only a few other services."""

from __future__ import annotations

import json

from rorg.model.catalog import DEVELOPER, Request
from rorg.store.requests_document import RequestsDocument

MOST_REQUESTS = 100
"""Of one requester."""
MOST_NAMED = 1000
"""Services and groups that the requests of one requester may name in all: each pass and each write of the file looks at
all of them."""
OF_ONE = 32 << 10
"""Bytes of the requests of one service."""
OF_SERVICES = 192 << 10
"""Bytes of the requests of all services."""
OF_ALL = 256 << 10
"""Bytes of all requests. A value has at least four bytes, so they are fewer than a file may have (`MAX_NODES`)."""
FIELDS = 120
"""Bytes for the names of fields, and for a time."""


def size(request: Request) -> int:
    """About how many bytes it takes in the file; characters that are not ASCII count as escapes."""
    own = (request.id, request.requester, *request.services, request.reason, request.incarnation, request.renewed)
    return len(json.dumps(own)) + FIELDS


def no_room(document: RequestsDocument, request: Request) -> str:
    """Why there is no room for a request; empty if there is."""
    others = [r for r in document.requests if r.key != request.key]
    own = [r for r in others if r.requester == request.requester]
    needed, taken = size(request), {r.key: size(r) for r in others}
    if len(own) >= MOST_REQUESTS:
        return f"{request.requester} has {len(own)} already"
    named = sum(len(r.services) for r in own)
    if named + len(request.services) > MOST_NAMED:
        return f"the requests of {request.requester} name {named} services already"
    limits = [("all requests", others, OF_ALL)]
    if request.requester != DEVELOPER:
        services = [r for r in others if r.requester != DEVELOPER]
        limits += [(f"the requests of {request.requester}", own, OF_ONE), ("those of services", services, OF_SERVICES)]
    for whose, requests, most in limits:
        if sum(taken[r.key] for r in requests) + needed > most:
            return f"{whose} would have more than {most >> 10} KiB"
    return ""
