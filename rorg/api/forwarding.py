"""Reading from the other machines of the robot: people have a socket for each, whose calls go to the rorg there, with
this machine's certificate. So every command that reads works for another machine, without rights of its own there."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from rorg.api.operations import Operations
from rorg.api.peer import Peer, explanation
from rorg.api.permissions import Caller, allow
from rorg.api.problems import answer
from rorg.api.tls import Tls
from rorg.errors import Busy, Missing, Refused, RorgError, Unreachable
from rorg.host.deadline import Deadline
from rorg.model.machines import Machine

MOST = 16
"""Calls that are forwarded at the same time: each has a thread."""
PATIENCE = 10.0
"""Seconds for a connection to the other machine; a wait there takes longer."""
LONGEST = 3700.0
"""Seconds of silence within an answer: of those who follow logs or events, and of waits."""
CHUNK, AHEAD = 1 << 16, 8
"""Bytes that are read at a time, and chunks that are read before the caller has taken them."""
KEPT = (b"content-type", b"content-length", b"rorg-cursor")
"""Headers of an answer that are passed on."""
Item = tuple[int, list[tuple[bytes, bytes]]] | bytes | Exception | None
"""Status and headers, then the body, piece by piece; the end, or why there is none."""


class Forwarded:
    """The ASGI application that passes on calls of such sockets, in front of another. `tls` gives the certificates."""

    def __init__(self, app: Any, operations: Operations, tls: Callable[[], Tls | None]) -> None:
        self.app, self.operations, self.tls = app, operations, tls
        self._pool = ThreadPoolExecutor(MOST, "forward")
        self._forwarding = 0

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        caller: Caller | None = scope.get("state", {}).get("caller")
        if scope["type"] != "http" or caller is None or not caller.at:
            await self.app(scope, receive, send)
            return
        try:
            machine, tls = self._allowed(caller, scope)
        except RorgError as error:
            await answer(error)(scope, receive, send)
            return
        self._forwarding += 1
        try:
            await self._forward(Stream(machine, tls, _target(scope)), scope, receive, send)
        finally:
            self._forwarding -= 1

    def _allowed(self, caller: Caller, scope: Any) -> tuple[Machine, Tls]:
        """The machine to ask, and by which certificate. Raises a RorgError."""
        allow(caller, "plan")
        what, tls = f"{scope['method']} {scope['path']} on {caller.at}", self.tls()
        if scope["method"] != "GET":
            raise Refused(what, "from another machine, rorg only reads", f"the same command on {caller.at}")
        machine = self.operations.catalog.machines.get(caller.at)
        if machine is None:
            raise Missing(what, "there is no such machine any more", "`rorg get machines`")
        if tls is None:
            raise Refused(what, "this rorg has no certificate", "`rorg run --certificates DIR`")
        if self._forwarding >= MOST or self.operations.ending:
            raise Busy(what, f"{self._forwarding} calls to other machines are under way", "again in a moment")
        return machine, tls

    async def _forward(self, stream: Stream, scope: Any, receive: Any, send: Any) -> None:
        loop = asyncio.get_running_loop()
        items: asyncio.Queue[Item] = asyncio.Queue()
        self._pool.submit(stream.run, lambda item: loop.call_soon_threadsafe(items.put_nowait, item))
        hangup = asyncio.ensure_future(_gone(receive))
        try:
            first = await _next(items, hangup)
            if isinstance(first, Exception):
                why = explanation(stream.machine, first)
                await answer(Unreachable(f"ask {stream.machine.name}", why))(scope, receive, send)
                return
            if not isinstance(first, tuple):
                return
            await send({"type": "http.response.start", "status": first[0], "headers": first[1]})
            while isinstance(chunk := await _next(items, hangup), bytes):
                stream.room.release()
                await send({"type": "http.response.body", "body": chunk, "more_body": True})
            if chunk is None:  # otherwise the answer is cut off, and the caller must see that
                await send({"type": "http.response.body", "body": b""})
        finally:
            hangup.cancel()
            stream.close()


class Stream:
    """One call to another machine, made by a thread."""

    def __init__(self, machine: Machine, tls: Tls, path: str) -> None:
        self.machine, self.path = machine, path
        self.room = threading.Semaphore(AHEAD)
        self._peer, self._closed = Peer(machine, tls), False

    def run(self, tell: Callable[[Item], object]) -> None:
        """Makes the call, and tells what comes. Returns when it has ended or was closed."""
        try:
            self._peer.connect(Deadline.within(PATIENCE))
            response = self._peer.begin("GET", self.path, Deadline.within(LONGEST))
            headers = (
                (name.lower().encode("latin-1"), value.encode("latin-1")) for name, value in response.getheaders()
            )
            tell((response.status, [header for header in headers if header[0] in KEPT]))
            while not self._closed and self.room.acquire(timeout=LONGEST):
                self._peer.bound(Deadline.within(LONGEST), sys.maxsize)
                chunk = response.read1(CHUNK)
                if not chunk:
                    tell(None)
                    return
                tell(chunk)
        except (OSError, http.client.HTTPException, ValueError, AttributeError) as error:
            with contextlib.suppress(RuntimeError):  # the server has stopped
                tell(error)
        finally:
            self._peer.close()

    def close(self) -> None:
        """Ends the call from any thread."""
        self._closed = True
        self.room.release()
        self._peer.hang_up()


def _target(scope: Any) -> str:
    query = scope.get("query_string", b"").decode("latin-1")
    path = scope.get("raw_path", scope["path"].encode()).decode("latin-1").partition("?")[0]
    return f"{path}?{query}" if query else path


async def _gone(receive: Any) -> None:
    while (await receive())["type"] != "http.disconnect":
        pass


async def _next(items: asyncio.Queue[Item], hangup: asyncio.Future[None]) -> Item:
    """The next item; None if the caller has hung up."""
    coming = asyncio.ensure_future(items.get())
    await asyncio.wait((coming, hangup), return_when=asyncio.FIRST_COMPLETED)
    if coming.done():
        return coming.result()
    coming.cancel()
    return None
