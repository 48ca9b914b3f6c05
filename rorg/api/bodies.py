"""What is read from requests and written into answers in more than one place."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Path
from fastapi.responses import JSONResponse, Response

from rorg.api.not_before import GENERATION
from rorg.errors import Invalid
from rorg.model.units import parse_duration


def accepted(generation: int, body: dict[str, Any] | None = None) -> Response:
    """The answer to a change: its generation, and what there is to say."""
    headers = {GENERATION: str(generation)}
    if body is None:
        return Response(status_code=204, headers=headers)
    return JSONResponse({**body, "generation": generation}, headers=headers)


Id = Annotated[str, Path(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.:-]{0,63}$")]


def duration(value: str | None, field: str) -> float:
    """Seconds of a duration in a body or a query; 0 where there is none. Raises Invalid."""
    try:
        seconds = parse_duration(value) if value is not None else 0.0
    except ValueError as error:
        raise Invalid("read the request", f"{field}: {error}") from error
    if value is not None and not seconds:
        raise Invalid("read the request", f"{field}: must be more than 0", "10s, for instance")
    return seconds
