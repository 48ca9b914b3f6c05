"""One connection of the server: who is at its other end, and for how long it may be idle."""

from __future__ import annotations

import socket
from collections import Counter
from collections.abc import Callable
from typing import Any

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

from rorg.api.permissions import Caller

MOST_OF_ONE = 200
"""Connections of one service; a person's program may have as many as there is room."""
IDLE = 60
"""Seconds after which a connection that asks nothing is closed."""


class Connection(HttpToolsProtocol):
    """Puts the caller into every request of its connection. No service may have so many connections that others find
    no room, and nobody one that asks nothing, or half of something, for ever."""

    who: Callable[[socket.socket | None, Any], Caller]
    open: Counter[str]
    """Service -> connections."""

    def connection_made(self, transport: Any) -> None:
        caller = self.who(transport.get_extra_info("socket"), transport)
        self.app_state = {**self.app_state, "caller": caller}
        self.service, self.begun, self.whole, self.seen = caller.service, 0, 0, (-1, -1)
        self.open[self.service] += 1
        self.refused = bool(self.service) and self.open[self.service] > MOST_OF_ONE
        if self.refused:
            transport.abort()
            return
        super().connection_made(transport)
        self._look = self.loop.call_later(IDLE, self._look_again)

    def connection_lost(self, error: Exception | None) -> None:
        self.open[self.service] -= 1
        if not self.refused:
            self._look.cancel()
            super().connection_lost(error)

    def data_received(self, data: bytes) -> None:
        if not self.refused:
            super().data_received(data)

    def on_message_begin(self) -> None:
        self.begun += 1
        super().on_message_begin()

    def on_message_complete(self) -> None:
        self.whole += 1
        super().on_message_complete()

    def _look_again(self) -> None:
        """Closes the connection when since the last look nothing was asked, and nothing is being answered."""
        answering = self.cycle is not None and not self.cycle.response_complete and self.begun == self.whole
        if not answering and self.seen == (self.begun, self.whole):
            self.transport.close()
            return
        self.seen = (self.begun, self.whole)
        self._look = self.loop.call_later(IDLE, self._look_again)
