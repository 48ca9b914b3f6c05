"""One connection of the server: who calls, how much the caller may send, and how long it may be silent."""

from __future__ import annotations

import socket
import time
from collections.abc import Callable
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from rorg.api import limits
from rorg.api.limits import Account, Accounts
from rorg.api.permissions import Caller
from rorg.api.problems import problem

Who = Callable[[socket.socket | None, Any], Caller]
"""Finds the caller at the other end of a connection, from its socket and its transport."""
CPU = time.thread_time
"""Gives the CPU seconds of the server's thread."""
PIECE = 8 << 10
"""Bytes that are parsed at a time, before limits are checked."""


class _Refusal(Exception):
    """The reason why a call is not taken."""

    def __init__(self, status: int, code: str, cause: str) -> None:
        self.status, self.code, self.cause = status, code, cause


class Connection(HttpToolsProtocol):
    """Puts the caller and its account into every request of its connection, and charges the account for what it reads.
    `due` is when the server closes the connection unless something happens before; the server checks all of them
    regularly."""

    who: Who
    accounts: Accounts
    left: Callable[[], int]
    """Gives the number of connections for which there is room."""

    def connection_made(self, transport: Any) -> None:
        caller = self.who(transport.get_extra_info("socket"), transport)
        self.account: Account = self.accounts.of(caller)
        self.app_state = {**self.app_state, "caller": caller, "account": self.account}
        self.due, self._begun, self._stuck = self.loop.time() + limits.IDLE, 0.0, 0
        self._asking = self._heading = False
        self._head = self._half = self._heads = self._lines = self._body = 0
        self._refusal = _Refusal(400, "invalid", "it is not HTTP/1.1")
        self.refused = not (self.account.fits(self.left()) or self.account.make_room())
        self.account.connections += 1
        self.account.charge(limits.GREETING)
        if self.refused:
            transport.abort()
        else:
            super().connection_made(transport)
            self.account.idle[self] = transport.abort

    def connection_lost(self, error: Exception | None) -> None:
        self.account.connections -= 1
        if not self.refused:
            self.resume_writing()
            super().connection_lost(error)
        self.account.idle.pop(self, None)

    # -- answers ---------------------------------------------------------------------------------------------

    def data_received(self, data: bytes) -> None:
        began = CPU()
        for at in range(0, len(data), PIECE):
            if self.refused or self.transport.is_closing():
                return
            self._read(data[at : at + PIECE])
        self.account.charge(CPU() - began)

    def _read(self, piece: bytes) -> None:
        before = self._heads
        super().data_received(piece)
        if self._heading and self._heads == before:
            # The parser keeps half a header without reporting it.
            self._half += len(piece)
            if self._half > limits.MOST_HEAD:
                self._refusal = _long()
                self.send_400_response("")

    def on_message_begin(self) -> None:
        if len(self.pipeline) >= limits.MOST_PIPELINED:
            self._refuse(_Refusal(400, "invalid", f"more than {limits.MOST_PIPELINED} requests wait for answers"))
        self._asking = self._heading = True
        self._heads += 1
        self._head = self._half = self._lines = self._body = 0
        self._begun = self.loop.time()
        super().on_message_begin()
        self._look()

    def on_url(self, url: bytes) -> None:
        self._more(len(url))
        super().on_url(url)

    def on_header(self, name: bytes, value: bytes) -> None:
        self._lines += 1
        self._more(len(name) + len(value) + 4)
        super().on_header(name, value)

    def _more(self, length: int) -> None:
        self._head += length
        if self._head > limits.MOST_HEAD or self._lines > limits.MOST_HEADERS:
            self._refuse(_long())

    def on_headers_complete(self) -> None:
        self._heading = False
        super().on_headers_complete()

    def on_body(self, body: bytes) -> None:
        self._body += len(body)
        if self._body > limits.MOST_DROPPED:
            self.transport.abort()
        super().on_body(body)

    def on_message_complete(self) -> None:
        self._asking = False
        super().on_message_complete()
        self._look()

    def _refuse(self, refusal: _Refusal) -> None:
        """Ends the parser, and so the connection."""
        self._refusal = refusal
        raise refusal

    def send_400_response(self, msg: str) -> None:  # noqa: ARG002 - ours says more
        """Answers with the reason, unless another answer is under way, and closes the connection."""
        self._heading = False
        if self.cycle is not None and not self.cycle.response_complete:
            self.transport.abort()
            return
        response = problem(self._refusal.status, self._refusal.code, "cannot read the request", self._refusal.cause)
        body = bytes(response.body)
        head = f"HTTP/1.1 {self._refusal.status} \r\ncontent-type: application/problem+json\r\n"
        self.transport.write(f"{head}content-length: {len(body)}\r\nconnection: close\r\n\r\n".encode() + body)
        self.transport.close()

    # -- what is answered --------------------------------------------------------------------------------------

    def on_response_complete(self) -> None:
        super().on_response_complete()
        self._look()
        owed = self.account.owed()
        if owed and not self.pipeline and not self.transport.is_closing():
            # A caller over its share is not even heard.
            self.flow.pause_reading()
            self.loop.call_later(owed, self._hear)

    def _hear(self) -> None:
        if not self.transport.is_closing():
            self.flow.resume_reading()

    def pause_writing(self) -> None:
        """The caller reads more slowly than it is answered. For a service, only so much is kept."""
        super().pause_writing()
        self._stuck = self.transport.get_write_buffer_size()
        self.account.unread += self._stuck
        self.due = self.loop.time() + limits.DEAF
        if self.account.limited and self.account.unread > limits.MOST_HELD:
            self.transport.abort()

    def resume_writing(self) -> None:
        super().resume_writing()
        self.account.unread -= self._stuck
        self._stuck = 0
        self._look()

    def _look(self) -> None:
        """Sets when the connection is due, after something has happened, and whether it is idle."""
        self.account.idle.pop(self, None)
        if self._stuck:
            return
        answering = bool(self.pipeline) or (self.cycle is not None and not self.cycle.response_complete)
        if self._asking:
            self.due = self._begun + limits.COMPLETE
        elif answering:
            self.due = float("inf")
        else:
            self.due = self.loop.time() + limits.IDLE
            self.account.idle[self] = self.transport.abort


def _long() -> _Refusal:
    most = f"{limits.MOST_HEAD} bytes and {limits.MOST_HEADERS} headers"
    return _Refusal(431, "too-large", f"its head may have {most}")
