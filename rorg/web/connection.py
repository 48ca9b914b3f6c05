"""A connection of the page's server. Whoever has no token keeps none: until a request is whole, its connection ends
after a while, or when others need the room."""

from __future__ import annotations

import asyncio
from typing import Any, ClassVar

from uvicorn.protocols.http.httptools_impl import HttpToolsProtocol

COMPLETE = 30.0
"""Seconds from the beginning of a connection, or of a request, to the end of the request."""
MOST_ASKING = 256
"""Connections without a whole request. One more ends the one that has taken longest: a browser sends its at once."""


class Connection(HttpToolsProtocol):
    """Ends with a request that takes too long."""

    asking: ClassVar[dict[Connection, asyncio.TimerHandle]] = {}
    """Those without a whole request, oldest first, with the timer that ends each."""

    def connection_made(self, transport: Any) -> None:
        super().connection_made(transport)
        self._ask()

    def connection_lost(self, error: Exception | None) -> None:
        self._asked()
        super().connection_lost(error)

    def on_message_begin(self) -> None:
        super().on_message_begin()
        self._ask()

    def on_message_complete(self) -> None:
        self._asked()
        super().on_message_complete()

    def _ask(self) -> None:
        if self not in self.asking:
            self.asking[self] = self.loop.call_later(COMPLETE, self.transport.abort)
            if len(self.asking) > MOST_ASKING:
                oldest = next(iter(self.asking))
                oldest._asked()
                oldest.transport.abort()

    def _asked(self) -> None:
        if timer := self.asking.pop(self, None):
            timer.cancel()
