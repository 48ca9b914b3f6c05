"""A listening socket of the server. It accepts connections while there is room and their caller owes nothing; others
are closed, or wait in the kernel."""

from __future__ import annotations

import asyncio
import contextlib
import socket
import ssl
from collections.abc import Callable

from rorg.api.limits import HANDSHAKE, MOST_HANDSHAKES, Account

AT_ONCE = 16
"""Connections that are accepted before other work has its turn."""
AGAIN = 0.2
"""Seconds until the next attempt, if a connection cannot be accepted (out of descriptors or memory)."""
FAREWELL = 5.0
"""Seconds for the end of a TLS connection."""

Protocol = Callable[[], asyncio.Protocol]


class Listener:
    """Accepts connections of `place`, a listening socket, until close(). `left` gives the room that is left; `account`
    is that of the socket's only caller, if it has only one."""

    def __init__(
        self,
        place: socket.socket,
        protocol: Protocol,
        left: Callable[[], int],
        account: Account | None = None,
        context: ssl.SSLContext | None = None,
    ) -> None:
        self.place, self.protocol, self.left, self.account, self.context = place, protocol, left, account, context
        self.greeted: dict[socket.socket, asyncio.Task[None]] = {}
        """Connections without a caller yet: with TLS, it is unknown until the handshake ends. Oldest first."""
        self._loop = asyncio.get_running_loop()
        self._pause: asyncio.TimerHandle | None = None
        place.setblocking(False)
        self._hear()

    def close(self) -> None:
        if self._pause:
            self._pause.cancel()
        self._loop.remove_reader(self.place.fileno())
        self.place.close()
        for greeting in self.greeted.values():
            greeting.cancel()

    def _hear(self) -> None:
        self._pause = None
        self._loop.add_reader(self.place.fileno(), self._take)

    def _rest(self, seconds: float) -> None:
        self._loop.remove_reader(self.place.fileno())
        self._pause = self._loop.call_later(seconds, self._hear)

    def _take(self) -> None:
        for _ in range(AT_ONCE):
            try:
                connection, _ = self.place.accept()
            except (BlockingIOError, ConnectionAbortedError):
                return
            except OSError:
                self._rest(AGAIN)
                return
            if self.left() <= 0:
                connection.close()
            else:
                self._greet(connection)
        if self.account and (owed := self.account.owed()):
            self._rest(owed)

    def _greet(self, connection: socket.socket) -> None:
        connection.setblocking(False)
        greeting = self._loop.create_task(self._connect(connection))
        self.greeted[connection] = greeting
        greeting.add_done_callback(lambda done: self._greeted(connection, done))
        if self.context and len(self.greeted) > MOST_HANDSHAKES:
            self.greeted.pop(next(iter(self.greeted))).cancel()

    def _greeted(self, connection: socket.socket, done: asyncio.Task[None]) -> None:
        self.greeted.pop(connection, None)
        if done.cancelled():
            connection.close()

    async def _connect(self, connection: socket.socket) -> None:
        more = {"ssl_handshake_timeout": HANDSHAKE, "ssl_shutdown_timeout": FAREWELL} if self.context else {}
        with contextlib.suppress(OSError):  # it has hung up, or does not speak TLS
            await self._loop.connect_accepted_socket(self.protocol, connection, ssl=self.context, **more)
