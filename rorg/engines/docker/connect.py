"""Connections to the engine: by a unix socket, TCP or TLS.

A stream in which one direction ends before the other needs more than Python's ssl has. TLS can say that (close_notify;
Docker's own command sends it), but after that a socket of ssl reads no more. So a thread carries everything between the
TLS connection and a pair of plain sockets.
"""

from __future__ import annotations

import http.client
import os
import select
import socket
import ssl
import threading
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlsplit

from rorg.errors import EngineError

DEFAULT = "unix:///var/run/docker.sock"
CHUNK = 1 << 16
"""Bytes that are read in one piece."""


def engine_host(given: str | None) -> str:
    """The engine's address: as given, or by DOCKER_HOST, or at Docker's default."""
    return given or os.environ.get("DOCKER_HOST") or DEFAULT


class _Unix(http.client.HTTPConnection):
    def __init__(self, path: str, timeout: float) -> None:
        super().__init__("docker", timeout=timeout)
        self.path = path

    def connect(self) -> None:
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.settimeout(self.timeout)
        self.sock.connect(self.path)


class _Tls(http.client.HTTPConnection):
    def connect(self) -> None:
        super().connect()
        self.sock = through_tls(self.sock, _tls(), self.host)


def connect(host: str, timeout: float, both_ways: bool = False) -> http.client.HTTPConnection:
    """Return a connection to the engine at `host`, not opened yet. Over one for `both_ways` either side can end its
    direction first. Raises EngineError for an address that rorg cannot use."""
    scheme, _, rest = host.rpartition("://")
    if scheme in ("unix", "http+unix"):
        return _Unix(rest, timeout)
    if scheme not in ("", "tcp", "http", "https"):
        # Not a forwarded unix socket: rorg would take that engine for this machine's, and its pids and ports too.
        there = urlsplit(f"//{rest}").hostname or "HOST"
        remedy = f"rorg on that machine, or DOCKER_HOST=tcp://{there}:2376 with DOCKER_TLS_VERIFY=1"
        raise EngineError("reach the engine", f"{host}: {scheme} is not supported", remedy if scheme == "ssh" else "")
    where, verified = urlsplit(f"//{rest}"), bool(os.environ.get("DOCKER_TLS_VERIFY"))
    name = where.hostname or "localhost"
    if both_ways and (scheme == "https" or verified):
        return _Tls(name, where.port or 2376, timeout=timeout)
    if scheme == "https" or verified:
        return http.client.HTTPSConnection(name, where.port or 2376, timeout=timeout, context=_tls())
    return http.client.HTTPConnection(name, where.port or 2375, timeout=timeout)


def _tls() -> ssl.SSLContext:
    """As for Docker's own commands, the authority and our certificate are files in DOCKER_CERT_PATH."""
    folder = Path(os.environ.get("DOCKER_CERT_PATH") or Path.home() / ".docker")
    authority = folder / "ca.pem"
    context = ssl.create_default_context(cafile=authority if authority.exists() else None)
    if (folder / "cert.pem").exists():
        context.load_cert_chain(folder / "cert.pem", folder / "key.pem")
    return context


def through_tls(there: socket.socket, context: ssl.SSLContext, name: str) -> socket.socket:
    """A plain socket for `there`, a connection to the host of this name. Raises OSError if the handshake fails."""
    carrier = _Carrier(there, context, name)
    carrier.handshake()
    carrier.near.settimeout(there.gettimeout())
    threading.Thread(target=carrier.run, name="tls", daemon=True).start()
    return carrier.near


class _Carrier:
    """Carries data until the other end has finished, or our reader is gone. Everything received is decrypted first."""

    def __init__(self, there: socket.socket, context: ssl.SSLContext, name: str) -> None:
        self._there, self._coming, self._going = there, ssl.MemoryBIO(), ssl.MemoryBIO()
        self._tls = context.wrap_bio(self._coming, self._going, server_hostname=name)
        self.near, self._far = socket.socketpair()
        self._encrypted, self._decrypted = b"", b""
        """Data to send to the other end, and data to read here."""
        self._more = True
        """Our side has not ended its direction."""

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
        """Wait, and carry what can be carried now. False at the end."""
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
        """False if nothing more will come."""
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
        with suppress(ssl.SSLWantReadError):  # close_notify was sent; it only could not read the other side's
            self._tls.unwrap()
