"""The API, version 1: the FastAPI application with all routes. Routes decide nothing; the operations do.

`python -m rorg.api.app FILE` writes its OpenAPI document.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from rorg import __version__
from rorg.api.description import add_description
from rorg.api.diff import add_diffing
from rorg.api.events import add_events
from rorg.api.history import add_history
from rorg.api.inputs import unreadable
from rorg.api.interventions import add_operating
from rorg.api.limits import MOST_BODY
from rorg.api.logs import add_logs
from rorg.api.machine_routes import add_machines
from rorg.api.manifests import add_manifests
from rorg.api.metrics import add_metrics
from rorg.api.models import Problem
from rorg.api.operations import Operations
from rorg.api.preview import add_previewing
from rorg.api.problems import answer, problem
from rorg.api.read_routes import add_reading
from rorg.api.request_routes import add_requesting
from rorg.api.ros2_routes import add_ros2
from rorg.errors import RorgError

RESPONSES: dict[int | str, dict[str, Any]] = {
    code: {"model": Problem, "description": what, "content": {"application/problem+json": {}}}
    for code, what in (
        (400, "not JSON"),
        (403, "forbidden"),
        (404, "not found"),
        (409, "refused"),
        (413, "too large"),
        (422, "invalid"),
        (429, "too many calls"),
        (503, "unavailable"),
        (504, "not ready"),
    )
}


def make_app(operations: Operations) -> FastAPI:
    """Makes the application."""
    app = FastAPI(
        title="rorg",
        version=__version__,
        docs_url=None,
        redoc_url=None,
        openapi_url="/v1/openapi.json",
        responses=RESPONSES,
    )
    app.state.operations = operations
    _errors(app)
    add_reading(app, operations)
    add_requesting(app, operations)
    add_operating(app, operations)
    add_events(app, operations)
    add_description(app, operations)
    add_logs(app, operations)
    add_manifests(app, operations)
    add_diffing(app, operations)
    add_previewing(app, operations)
    add_history(app, operations)
    add_metrics(app, operations)
    add_ros2(app, operations)
    add_machines(app, operations)
    return app


def _errors(app: FastAPI) -> None:
    @app.exception_handler(RorgError)
    async def told(_: Request, error: RorgError) -> JSONResponse:
        return answer(error)

    @app.exception_handler(RequestValidationError)
    async def invalid(_: Request, error: RequestValidationError) -> JSONResponse:
        return answer(unreadable(error.errors()))

    @app.exception_handler(HTTPException)
    async def http(request: Request, error: HTTPException) -> JSONResponse:
        code = {404: "not-found", 405: "no-such-method"}.get(error.status_code, "invalid")
        response = problem(error.status_code, code, f"cannot {request.method} {request.url.path}", str(error.detail))
        response.headers.update(error.headers or {})
        return response

    @app.exception_handler(Exception)
    async def bug(request: Request, error: Exception) -> JSONResponse:
        return problem(
            500,
            "internal",
            f"cannot {request.method} {request.url.path}",
            f"{type(error).__name__}: {error}",
            "to report this bug",
        )

    app.add_middleware(_Bounded)


class _Bounded:
    """Refuses a body that is too large, or that does not declare its length, before reading any of it."""

    def __init__(self, app: Any) -> None:
        self.app = app

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        headers = dict(scope.get("headers", ()))
        length = headers.get(b"content-length", b"0")
        if b"transfer-encoding" in headers or not length.isdigit() or int(length) > MOST_BODY:
            await problem(
                413,
                "too-large",
                "cannot read the request",
                f"its body may have {MOST_BODY} bytes, and must say how many",
            )(scope, receive, send)
        else:
            await self.app(scope, receive, send)


def document() -> dict[str, Any]:
    """The OpenAPI document, of an application without a running loop."""
    return make_app(None).openapi()  # type: ignore[arg-type]


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(json.dumps(document(), indent=1, sort_keys=True) + "\n", encoding="utf-8")
