"""What is read from requests and written into answers in more than one place."""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import Path
from fastapi.responses import JSONResponse, Response

from rorg.api.not_before import GENERATION


def accepted(generation: int, body: dict[str, Any] | None = None) -> Response:
    """The answer to a change: its generation, and what there is to say."""
    headers = {GENERATION: str(generation)}
    if body is None:
        return Response(status_code=204, headers=headers)
    return JSONResponse({**body, "generation": generation}, headers=headers)


Id = Annotated[str, Path(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.:-]{0,63}$")]
