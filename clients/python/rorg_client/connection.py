"""One connection of the blocking client."""

from __future__ import annotations

import contextlib
import socket
from typing import TypeVar

from rorg_client.address import Address
from rorg_client.wire import LINE, LONGEST, Reading

T = TypeVar("T")


class Connection:
    """A connection, opened when it is made. Every failure is an OSError."""

    def __init__(self, address: Address, timeout: float | None) -> None:
        self.socket = address.connect(timeout)
        self._file = self.socket.makefile("rb")

    def send(self, data: bytes, timeout: float | None) -> None:
        self.socket.settimeout(timeout)
        self.socket.sendall(data)

    def drive(self, reading: Reading[T]) -> T:
        """Feeds a reader until it has everything."""
        try:
            wanted = next(reading)
            while True:
                wanted = reading.send(self._file.readline(LONGEST) if wanted == LINE else self._file.read(wanted))
        except StopIteration as done:
            found: T = done.value
            return found

    def abort(self) -> None:
        """Ends what another thread reads on it."""
        with contextlib.suppress(OSError):
            self.socket.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        with contextlib.suppress(OSError):
            self._file.close()
            self.socket.close()
