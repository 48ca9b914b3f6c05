"""Serves the page, its feed, and its calls of the API, on the loopback interface."""

from __future__ import annotations

import asyncio
import json
import secrets
import socket
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

import uvicorn
from rorg_client import Client, Error
from rorg_client.aio import AsyncClient
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, Response, StreamingResponse
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from rorg.errors import Invalid
from rorg.web.connection import Connection
from rorg.web.feed import Feed
from rorg.web.gate import Gate

PAGE = Path(__file__).parent / "page"
HOST = "127.0.0.1"
MOST_BODY = 1 << 20
"""Bytes of a call: a manifest."""
BODIES = ("PUT", "POST")
"""Methods of calls that have a body."""
EVENTS = "text/event-stream"
HEARTBEAT = 15.0
"""Seconds after which a page without news hears that the feed goes on."""


class Page:
    """A server of the page for one rorg. `client` makes a client of that rorg."""

    def __init__(self, client: Callable[[], Client], port: int = 0, read_only: bool = False, token: str = "") -> None:
        """Raises Invalid if the port is taken."""
        try:
            self.socket = socket.create_server((HOST, port))
        except OSError as error:
            raise Invalid(f"serve the page on {HOST}:{port}", str(error.strerror), "another --port") from error
        self.port, self.token = self.socket.getsockname()[1], token or secrets.token_urlsafe(24)
        self.read_only, known = read_only, client()
        # Each call may wait; a thread for each would leave none for the next one.
        self._client = AsyncClient(str(known.address), known.timeout, known.patience)
        self.feed = Feed(client)
        config = uvicorn.Config(
            Gate(self._app(), self.token, self.port, read_only),
            http=Connection,
            log_config=None,
            access_log=False,
            lifespan="on",
            ws="none",
            server_header=False,
            timeout_graceful_shutdown=1,
        )
        self.uvicorn = uvicorn.Server(config)

    @property
    def address(self) -> str:
        """Its address with the token, which opens it."""
        return f"http://{HOST}:{self.port}/?token={self.token}"

    def run(self) -> None:
        """Serve until SIGINT or SIGTERM."""
        self.uvicorn.run([self.socket])

    def _app(self) -> Starlette:
        @asynccontextmanager
        async def lifespan(_: Starlette) -> AsyncGenerator[None, None]:
            self.feed.start()
            yield
            self.feed.stop()

        routes = [
            Route("/", lambda _: FileResponse(PAGE / "index.html")),
            Route("/feed", self._feed),
            Route("/api/{path:path}", self._call, methods=["GET", "PUT", "POST", "DELETE"]),
            Mount("/page", StaticFiles(directory=PAGE)),
        ]
        return Starlette(routes=routes, lifespan=lifespan)

    async def _feed(self, request: Request) -> Response:
        """Server-sent events: first the whole state, then each change."""
        if request.method == "HEAD":
            return Response(media_type=EVENTS)
        queue = self.feed.join()

        async def messages() -> AsyncGenerator[str, None]:
            about = "true" if self.read_only else "false"
            try:
                yield f'event: page\ndata: {{"read_only": {about}}}\n\n'
                while not self.uvicorn.should_exit:
                    try:
                        text = await asyncio.wait_for(queue.get(), HEARTBEAT)
                    except TimeoutError:
                        yield ": still here\n\n"
                        continue
                    if not text:
                        return  # it was too late; the browser connects again
                    yield f"data: {text}\n\n"
            finally:
                self.feed.leave(queue)

        return StreamingResponse(messages(), media_type=EVENTS)

    async def _call(self, request: Request) -> Response:
        """One call of the API, as if the user had made it."""
        body = await _body(request)
        path = f"/{quote(request.path_params['path'])}" + (f"?{request.url.query}" if request.url.query else "")
        if not path.startswith("/v1/") or "follow" in request.query_params:
            return Response("the page does not pass this on", 404)
        if body is None:
            return Response("no JSON, or more than 1 MiB", 413)
        # A refusal is an answer too: as an HTTP error, the browser would report it to the console.
        try:
            method = "GET" if request.method == "HEAD" else request.method
            return JSONResponse({"answer": await self._client.call(method, path, body if method in BODIES else None)})
        except Error as error:
            confirm = getattr(error, "confirm", [])
            return JSONResponse({"refused": {"cause": error.cause, "remedy": error.remedy, "confirm": confirm}})


async def _body(request: Request) -> Any:
    """Return the body as JSON: {} without one, None if it is too large or no JSON."""
    whole = b""
    async for piece in request.stream():
        whole += piece
        if len(whole) > MOST_BODY:
            return None
    try:
        return json.loads(whole) if whole else {}
    except (ValueError, RecursionError):
        return None
