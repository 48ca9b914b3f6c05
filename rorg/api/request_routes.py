"""Routes that request and release services, and the one that answers when they are ready."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable
from typing import Annotated, Any

from fastapi import FastAPI, Query, Request
from fastapi.responses import JSONResponse, Response
from starlette.types import Receive

from rorg.api.callers import Id, Requester, Who, accepted, applied, needs, still
from rorg.api.changes import release as releasing
from rorg.api.generations import until
from rorg.api.inputs import PutRequest, request_of
from rorg.api.models import RequestView, WaitResult
from rorg.api.operations import Operations
from rorg.api.permissions import allow_request
from rorg.api.readiness import Question
from rorg.errors import NotReady

SEEN = 5.0
"""Seconds within which the loop has seen that a service runs, if it requests something right after its start."""
PROMPT = 3.0
"""Seconds for a caller with a timeout of 0: enough for one attempt of probes whose last answers are too old, and for
the loop to act on the caller's last change."""


def add_requesting(app: FastAPI, operations: Operations) -> None:
    """Adds the routes."""
    _add_put(app, operations)
    _add_wait(app, operations)
    request = [needs("request")]

    @app.post("/v1/requests/{id}/renew", dependencies=request, response_model=RequestView)
    async def renew(id: Id, caller: Who, requester: Requester = None) -> Response:
        """Renew the lease of a request for its full time."""
        return JSONResponse(operations.renew(caller, (requester or caller.requester, id)))

    @app.delete("/v1/requests/{id}", dependencies=request, status_code=204, response_class=Response)
    async def release(id: Id, caller: Who, force: bool = True, requester: Requester = None) -> Response:
        """End a request. Releasing twice is no error. With `force=false`, rorg refuses if that stops a driver, or takes
        something from a service that asked for it: `confirm` names these."""
        key = requester or caller.requester, id
        allow_request(caller, key[0], (), operations.catalog)
        return await applied(operations, caller, releasing(key, None if force else operations.current))


def _add_put(app: FastAPI, operations: Operations) -> None:
    @app.put("/v1/requests/{id}", dependencies=[needs("request")], response_model=RequestView)
    async def put(
        request: Request,
        id: Id,
        body: PutRequest,
        caller: Who,
        requester: Requester = None,
        wait: Annotated[float | None, Query(ge=0, le=3600, description="Longest time until they are ready.")] = None,
    ) -> Response:
        """Request services, in place of an earlier request with the same id. It is on the disk when answered. With
        `wait`, the answer comes when they are ready, as that of /v1/wait; if they are not, it has the reason, and the
        request stands."""
        ask = request_of(id, requester or caller.requester, body)
        # A program may ask so soon after its start that the loop has not seen it run.
        await until(operations, lambda: caller.kind != "service" or operations.current.runs(caller.service), SEEN)
        generation = await asyncio.wrap_future(operations.put_request(caller, ask))
        ready = None if wait is None else await _readiness(operations, request, ask.services, wait)
        told = {
            "id": id,
            "requester": ask.requester,
            "services": list(ask.services),
            "reason": ask.reason,
            "priority": ask.priority,
            "ttl": ask.ttl,
            **({} if ready is None else {"readiness": ready}),
        }
        return accepted(generation, told)


def _add_wait(app: FastAPI, operations: Operations) -> None:
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
        return JSONResponse({"ready": True, "services": await _readiness(operations, request, services, timeout)})


async def _readiness(
    operations: Operations, request: Request, services: Iterable[str], timeout: float
) -> dict[str, Any]:
    """The readiness of services and all that they need, once they are ready. Raises NotReady."""
    names = tuple(dict.fromkeys(m for s in services for m in operations.current.members(s)))
    with operations.question(names, waits=timeout > 0) as question:
        hangup = asyncio.ensure_future(gone(request.receive))
        try:
            return await _ready(operations, question, timeout, request, hangup)
        finally:
            hangup.cancel()


async def gone(receive: Receive) -> None:
    """Returns when the caller has closed the connection."""
    while (await receive())["type"] != "http.disconnect":
        pass


async def _ready(
    operations: Operations, question: Question, timeout: float, request: Request, hangup: asyncio.Future[None]
) -> dict[str, Any]:
    clock = asyncio.get_running_loop().time
    deadline = clock() + (timeout if question.waits else PROMPT)
    while not hangup.done():
        event = operations.next_pass()
        still(request, "read")
        known = operations.open_to(question.generation) and (not question.waits or operations.heard_since(question))
        readiness = operations.readiness(question)
        services = {name: ready.as_json() for name, ready in readiness.services.items()}
        left = deadline - clock()
        if known and readiness.ready:
            return services
        settled = known and (readiness.hopeless if question.waits else not readiness.asking)
        if settled or left <= 0:
            raise NotReady(
                f"wait for {', '.join(question.names)}",
                readiness.reason or ("the loop is busy" if operations.heard_since(question) else "the engine is busy"),
                "`rorg why` for the reasons",
                services,
            )
        news = asyncio.ensure_future(event.wait())
        await asyncio.wait((news, hangup), timeout=left, return_when=asyncio.FIRST_COMPLETED)
        news.cancel()
    return {}  # the caller has hung up
