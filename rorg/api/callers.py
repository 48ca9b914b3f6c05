"""What all routes share: who calls, and the row of the table of permissions that a route is in."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Depends, Query, Request

from rorg.api.permissions import Caller, acting, allow, allow_call

Requester = Annotated[str | None, Query(description="In whose name; by default the caller's own.")]


def caller_of(request: Request) -> Caller:
    """Who is at the other end of the connection, as the server found out; where it acts for another, that one. Raises
    Forbidden where the manifests of now do not let it."""
    found: Caller = getattr(request.state, "caller", Caller())
    if found.kind != "service":
        return found
    catalog = request.app.state.operations.catalog
    allow_call(found, catalog)
    requester = request.query_params.get("requester")
    return found if requester in (None, found.service) else acting(found, requester, catalog)


Who = Annotated[Caller, Depends(caller_of)]


def still(request: Request, operation: str) -> Caller:
    """The caller of an answer that takes its time, looked at again: raises Forbidden for what was withdrawn since."""
    caller = caller_of(request)
    allow(caller, operation)
    return caller


def needs(operation: str) -> Any:
    """Marks a route with the operation that it is in the table of permissions."""

    def check(caller: Who) -> None:
        allow(caller, operation)

    check.operation = operation  # type: ignore[attr-defined]
    return Depends(check)
