"""How much may be asked for at once, so that what is accepted can always be read back, soon. A service that asks for as
much as it may takes no room from people, nor from more than a few others."""

from __future__ import annotations

import json

from rorg.model.catalog import DEVELOPER, Request
from rorg.store.requests_document import RequestsDocument

MOST_REQUESTS = 100
"""Of one requester."""
MOST_NAMED = 1000
"""Services and groups that the requests of one requester may name in all: each pass, and each write of the file, looks
at every one."""
OF_ONE = 32 << 10
"""Bytes of the requests of one service."""
OF_SERVICES = 192 << 10
"""Bytes of the requests of all services."""
OF_ALL = 256 << 10
"""Bytes of all requests. A value takes four bytes at least, so they are fewer than a file may have (`MAX_NODES`)."""
FIELDS = 120
"""Bytes for the names of fields, and for a time."""


def size(request: Request) -> int:
    """Bytes that it takes in the file, about; what is not ASCII counts as its escape."""
    own = (request.id, request.requester, *request.services, request.reason, request.incarnation, request.renewed)
    return len(json.dumps(own)) + FIELDS


def no_room(document: RequestsDocument, request: Request) -> str:
    """Why a request cannot be put too; empty where it can."""
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
