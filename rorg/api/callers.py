"""What all routes share: who calls, and the row of the table of permissions that a route is in."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Depends, Query, Request

from rorg.api.permissions import Caller, acting, allow

Requester = Annotated[str | None, Query(description="In whose name; by default the caller's own.")]


def caller_of(request: Request) -> Caller:
    """Who is at the other end of the connection, as the server found out; where it acts for another, that one."""
    found: Caller = getattr(request.state, "caller", Caller())
    requester = request.query_params.get("requester")
    if requester is None or found.kind != "service" or requester == found.service:
        return found
    return acting(found, requester, request.app.state.operations.catalog)


Who = Annotated[Caller, Depends(caller_of)]


def needs(operation: str) -> Any:
    """Marks a route with the operation that it is in the table of permissions."""

    def check(caller: Who) -> None:
        allow(caller, operation)

    check.operation = operation  # type: ignore[attr-defined]
    return Depends(check)
