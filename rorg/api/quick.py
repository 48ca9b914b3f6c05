"""How a service is, answered fast."""

from __future__ import annotations

from typing import Any

from rorg.api.operations import Operations
from rorg.api.permissions import allow, allow_call
from rorg.errors import RorgError


class Quick:
    """Answers the one question that programs ask all the time, how a service is, without FastAPI's machinery, which
    takes most of the time. Whatever is not plain success is left to the application."""

    PREFIX = "/v1/services/"

    def __init__(self, app: Any, operations: Operations) -> None:
        self.app, self.operations = app, operations

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        name = (
            scope["path"][len(self.PREFIX) :]
            if scope.get("method") == "GET" and scope["path"].startswith(self.PREFIX)
            else "/"
        )
        if "/" not in name:
            try:
                allow(scope["state"]["caller"], "read")
                allow_call(scope["state"]["caller"], self.operations.catalog)
                body = self.operations.service_text(name)
            except RorgError:
                pass
            else:
                headers = [(b"content-type", b"application/json"), (b"content-length", str(len(body)).encode())]
                await send({"type": "http.response.start", "status": 200, "headers": headers})
                await send({"type": "http.response.body", "body": body})
                return
        await self.app(scope, receive, send)
