"""A connection with TLS as a plain socket, for streams of which one direction ends before the other.

TLS has a word for that (close_notify; Docker's own command sends it), but a socket of Python's ssl can only say it and
read no more. So a thread carries everything between the connection and a pair of sockets.
"""

from __future__ import annotations

import select
import socket
import ssl
import threading
from contextlib import suppress

CHUNK = 1 << 16
"""Bytes that are read at once."""


def through_tls(there: socket.socket, context: ssl.SSLContext, name: str) -> socket.socket:
    """A socket in place of `there`, a connection to the host of this name. Raises OSError where the handshake fails."""
    carrier = _Carrier(there, context, name)
    carrier.handshake()
    carrier.near.settimeout(there.gettimeout())
    threading.Thread(target=carrier.run, name="tls", daemon=True).start()
    return carrier.near


class _Carrier:
    """Carries until the other end has nothing more to say, or nobody here reads. All that has come is always decrypted
    before anything else is done."""

    def __init__(self, there: socket.socket, context: ssl.SSLContext, name: str) -> None:
        self._there, self._coming, self._going = there, ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(self._coming, self._going, server_hostname=name)
        self.near, self._far = socket.socketpair()
        self._encrypted, self._decrypted = b"", b""
        """What is still to be sent there, and to be read here."""
        self._more = True
        """The other direction has not ended here."""

    def handshake(self) -> None:
        while True:
            try:
                self._tls.do_handshake()
                return
            except ssl.SSLWantReadError:
                self._there.sendall(self._going.read())
                self._take()

    def run(self) -> None:
        with self._there, self._far, suppress(OSError):
            self._there.sendall(self._going.read())
            self._there.setblocking(False)
            self._far.setblocking(False)
            while self._carry():
                pass
            self._far.setblocking(True)
            self._far.sendall(self._decrypted)

    def _carry(self) -> bool:
        """What can be carried at this moment; waits for something. False at the end."""
        waiting = select.poll()
        waiting.register(
            self._far, select.POLLIN * (self._more and not self._encrypted) | select.POLLOUT * bool(self._decrypted)
        )
        waiting.register(self._there, select.POLLIN * (not self._decrypted) | select.POLLOUT * bool(self._encrypted))
        ready = dict(waiting.poll())
        here, there = ready.get(self._far.fileno(), 0), ready.get(self._there.fileno(), 0)
        if here & select.POLLHUP and not here & select.POLLIN:
            return False
        if there & ~select.POLLOUT:
            self._take()
        open_there = self._decrypt()
        if here & select.POLLIN:
            self._encrypt()
        self._encrypted += self._going.read()
        with suppress(BlockingIOError):
            self._encrypted = self._encrypted[self._there.send(self._encrypted) :]
        with suppress(BlockingIOError):
            self._decrypted = self._decrypted[self._far.send(self._decrypted) :]
        return open_there

    def _take(self) -> None:
        with suppress(BlockingIOError):
            if chunk := self._there.recv(CHUNK):
                self._coming.write(chunk)
            else:
                self._coming.write_eof()

    def _decrypt(self) -> bool:
        """False where nothing more comes."""
        try:
            while chunk := self._tls.read(CHUNK):
                self._decrypted += chunk
        except ssl.SSLWantReadError:
            return True
        except (ssl.SSLZeroReturnError, ssl.SSLEOFError):
            pass
        return False

    def _encrypt(self) -> None:
        if chunk := self._far.recv(CHUNK):
            self._tls.write(chunk)
            return
        self._more = False
        with suppress(ssl.SSLWantReadError):  # it has said so, and would like to read the other side's word
            self._tls.unwrap()
