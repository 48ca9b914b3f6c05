"""Checks whether an engine answers at all."""

from __future__ import annotations

import http.client
import select
import time
from collections.abc import Callable

from rorg.engines.docker.errors import NoAnswer
from rorg.errors import Unreachable

OPEN = 10.0
"""Seconds to wait for the answer to a ping before trying another connection: a frozen engine answers on the old one
when it goes on, but beyond a broken network no answer ever comes."""

Connect = Callable[[float], http.client.HTTPConnection]
"""Makes a connection, which must open within so many seconds."""


class Ping:
    """Pings on a connection of its own, because other calls may rightly take long. While a ping is not answered no
    other one is sent, so that a frozen engine does not collect connections. `host` is for messages, `seconds` how long
    an answer may take."""

    def __init__(self, connect: Connect, host: str, seconds: float) -> None:
        self._connect, self.host, self.seconds = connect, host, seconds
        self._connection: http.client.HTTPConnection | None = None
        self._asked: float | None = None
        """When the ping was sent that has no answer yet."""

    def ask(self) -> None:
        """Return when the engine has answered. Raises NoAnswer."""
        try:
            self._ask()
        except (OSError, http.client.HTTPException) as error:
            if not isinstance(error, TimeoutError):
                self.close()
            raise NoAnswer(self.host, self.seconds) from error

    def close(self) -> None:
        if self._connection is not None:
            self._connection.close()
        self._connection, self._asked = None, None

    def _ask(self) -> None:
        if self._asked is not None and time.monotonic() > self._asked + OPEN:
            self.close()
        connection = self._connection
        if self._asked is None:
            if (
                connection is None or connection.sock is None or readable(connection, 0.0)
            ):  # its end: the engine was restarted
                self.close()
                connection = self._connection = self._connect(self.seconds)
            connection.request("GET", "/_ping")
            self._asked = time.monotonic()
        assert connection is not None
        if not readable(connection, self.seconds):
            raise TimeoutError
        connection.getresponse().read()  # any answer will do
        self._asked = None


class Pinger:
    """The same with rorg's errors."""

    def __init__(self, ping: Ping) -> None:
        self._ping = ping
        self.close = ping.close

    def ask(self) -> None:
        try:
            self._ping.ask()
        except NoAnswer as error:
            raise Unreachable("reach the engine", error.why) from error


def readable(connection: http.client.HTTPConnection, seconds: float) -> bool:
    """Whether anything, even the end, comes within so many seconds."""
    waiting = select.poll()
    waiting.register(connection.sock, select.POLLIN)
    return bool(waiting.poll(seconds * 1000))
