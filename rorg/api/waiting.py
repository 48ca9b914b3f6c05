"""The route that answers when services are ready."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Annotated

from fastapi import FastAPI, Query, Request
from fastapi.responses import JSONResponse, Response
from starlette.types import Receive

from rorg.api.callers import needs, still
from rorg.api.models import (
    WaitResult,
)
from rorg.api.operations import Operations
from rorg.api.readiness import Question
from rorg.errors import NotReady

PROMPT = 3.0
"""Seconds that a caller without time waits for one attempt of probes whose last answers are too old, or for the loop to
act on its last change."""


async def gone(receive: Receive) -> None:
    """Returns when the caller has closed the connection."""
    while (await receive())["type"] != "http.disconnect":
        pass


async def _ready(
    operations: Operations,
    question: Question,
    timeout: float,
    changed: Callable[[], asyncio.Event],
    hangup: asyncio.Future[None],
    allowed: Callable[[], object],
) -> Response:
    clock = asyncio.get_running_loop().time
    deadline = clock() + (timeout if question.waits else PROMPT)
    while not hangup.done():
        event = changed()
        allowed()
        known = operations.open_to(question.generation) and (not question.waits or operations.heard_since(question))
        found = operations.readiness(question)
        services = {name: ready.as_json() for name, ready in found.services.items()}
        left = deadline - clock()
        if known and found.ready:
            return JSONResponse({"ready": True, "services": services})
        settled = known and (found.hopeless if question.waits else not found.asking)
        if settled or left <= 0:
            raise NotReady(
                f"wait for {', '.join(question.names)}",
                found.reason or ("the loop is busy" if operations.heard_since(question) else "the engine is busy"),
                "`rorg why` for the reasons",
                services,
            )
        news = asyncio.ensure_future(event.wait())
        await asyncio.wait((news, hangup), timeout=left, return_when=asyncio.FIRST_COMPLETED)
        news.cancel()
    return Response(status_code=400)  # nobody reads it


def add_waiting(app: FastAPI, operations: Operations, changed: Callable[[], asyncio.Event]) -> None:
    """The route that waits until services are ready."""

    @app.get("/v1/wait", dependencies=[needs("read")], response_model=WaitResult)
    async def wait(
        request: Request,
        services: Annotated[list[str], Query(min_length=1, max_length=300)],
        timeout: Annotated[float, Query(ge=0, le=3600)] = 30.0,
    ) -> Response:
        """Answers when these services and all that they need are ready: wanted, running, their probes answered since
        the question was asked, and nothing under way that ends this run. If they do not become ready, the answer has
        the reason. With a timeout of 0, the last answer of a probe counts if it is younger than the probe's interval;
        otherwise the probe is asked once. Every change that was accepted before the question counts."""
        names = tuple(dict.fromkeys(m for s in services for m in operations.members(s)))
        with operations.question(names, waits=timeout > 0) as question:
            hangup = asyncio.ensure_future(gone(request.receive))
            try:
                return await _ready(operations, question, timeout, changed, hangup, lambda: still(request, "read"))
            finally:
                hangup.cancel()
