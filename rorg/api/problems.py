"""Errors as answers: application/problem+json (RFC 9457) with a stable code, the cause and the remedy."""

from __future__ import annotations

from typing import Any

from fastapi.responses import JSONResponse

from rorg.errors import (
    Busy,
    Forbidden,
    Invalid,
    Missing,
    NotReady,
    Refused,
    RorgError,
    TooMany,
    Unconfirmed,
    Unreachable,
)

STATUS: dict[type[RorgError], tuple[int, str]] = {
    Forbidden: (403, "forbidden"),
    Missing: (404, "not-found"),
    Refused: (409, "refused"),
    Invalid: (422, "invalid"),
    NotReady: (504, "not-ready"),
    TooMany: (429, "too-many-requests"),
    Busy: (503, "busy"),
    Unreachable: (503, "unreachable"),
}
"""Error -> HTTP status and stable code; the nearest base class counts."""


def problem(status: int, code: str, what: str, cause: str, remedy: str = "", **more: Any) -> JSONResponse:
    """The answer to an error, with a stable code, its cause and its remedy."""
    return JSONResponse(
        {
            "type": f"urn:rorg:{code}",
            "title": what,
            "status": status,
            "code": code,
            "cause": cause,
            "remedy": remedy,
            **more,
        },
        status,
        media_type="application/problem+json",
    )


def answer(error: RorgError) -> JSONResponse:
    """The answer to one of rorg's errors; with Retry-After if trying again soon makes sense."""
    status, code = next((STATUS[t] for t in type(error).__mro__ if t in STATUS), (500, "internal"))
    more: dict[str, Any] = {"services": error.services} if isinstance(error, NotReady) and error.services else {}
    more |= {"confirm": list(error.services)} if isinstance(error, Unconfirmed) else {}
    response = problem(status, code, f"cannot {error.what}", error.why, error.remedy, **more)
    if isinstance(error, Busy):
        response.headers["Retry-After"] = str(error.seconds)
    return response
