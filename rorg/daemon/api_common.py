"""What all routes share: who calls, and the row of the table of rights that a route is in."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Depends, Request

from rorg.daemon.rights import Caller, allow


def caller_of(request: Request) -> Caller:
    """Who is at the other end of the connection, as the door found out."""
    return getattr(request.state, "caller", Caller())


Who = Annotated[Caller, Depends(caller_of)]


def needs(operation: str) -> Any:
    """Marks a route with the operation that it is in the table of rights."""
    def check(caller: Who) -> None:
        allow(caller, operation)

    check.operation = operation  # type: ignore[attr-defined]
    return Depends(check)
