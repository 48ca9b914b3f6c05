"""Routes by which services are requested and released."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

from fastapi import FastAPI
from fastapi.responses import JSONResponse, Response

from rorg.api.bodies import Id, accepted
from rorg.api.body_models import PutRequest
from rorg.api.callers import Requester, Who, needs
from rorg.api.inputs import request_of
from rorg.api.models import RequestView
from rorg.api.operations import Operations
from rorg.api.permissions import Caller

SEEN = 5.0
"""Seconds until a service that asks is seen to run."""


async def _seen(operations: Operations, caller: Caller, changed: Callable[[], asyncio.Event]) -> None:
    """A program may ask so soon after its start that the loop has not seen it run: that is waited for."""
    end = asyncio.get_running_loop().time() + SEEN
    while caller.kind == "service" and not operations.runs(caller.service):
        left = end - asyncio.get_running_loop().time()
        if left <= 0:
            return
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(changed().wait(), left)


def add_requesting(app: FastAPI, operations: Operations, changed: Callable[[], asyncio.Event]) -> None:
    """The routes of requests."""
    request = [needs("request")]

    @app.put("/v1/requests/{id}", dependencies=request, response_model=RequestView)
    async def put(id: Id, body: PutRequest, caller: Who, requester: Requester = None) -> Response:
        """Request services, in place of an earlier request of the same id. Durable when answered."""
        ask = request_of(id, requester or caller.requester, body)
        await _seen(operations, caller, changed)
        return accepted(
            await asyncio.wrap_future(operations.put_request(caller, ask)),
            {
                "id": id,
                "requester": ask.requester,
                "services": list(ask.services),
                "reason": ask.reason,
                "priority": ask.priority,
                "ttl": ask.ttl,
            },
        )

    @app.post("/v1/requests/{id}/renew", dependencies=request, response_model=RequestView)
    async def renew(id: Id, caller: Who, requester: Requester = None) -> Response:
        """Give the lease of a request its full time again."""
        return JSONResponse(operations.renew(caller, (requester or caller.requester, id)))

    @app.delete("/v1/requests/{id}", dependencies=request, status_code=204, response_class=Response)
    async def release(id: Id, caller: Who, force: bool = True, requester: Requester = None) -> Response:
        """End a request. Releasing what is already released is no error. With `force=false` it is refused where it
        stops what moves hardware, or takes something from a service that asked for it: `confirm` names these."""
        key = requester or caller.requester, id
        return accepted(await asyncio.wrap_future(operations.release(caller, key, force)))
