"""Asks a program by TCP, HTTP or HTTPS, with bounds, because it may be anything: each question has one deadline from
the look-up of the name to the last byte, and a limit of what is read. No redirects, no proxies."""

from __future__ import annotations

import contextlib
import errno
import http.client
import socket
import ssl
import threading
from collections.abc import Iterator, Mapping
from concurrent.futures import Future
from functools import cache
from typing import Any
from urllib.parse import urlsplit

from rorg.host.deadline import Deadline

HEAD = 64 << 10
"""Bytes of an answer of which only the head is read. A usual one has a few hundred."""
_lookups: dict[tuple[str, int], Future[list[Any]]] = {}
"""Names that are being looked up. The resolver has no deadline, so every caller that asks for the same name meanwhile
waits for the same look-up."""
_lock = threading.Lock()


PORTS = {"http": 80, "https": 443}


class Connection(socket.socket):
    """Every read and write ends with the deadline; reading more than `most` bytes in all raises OSError."""

    deadline: Deadline
    most: int

    def bound(self, deadline: Deadline, most: int) -> None:
        self.deadline, self.most = deadline, most

    def recv_into(self, buffer: Any, nbytes: int = 0, flags: int = 0) -> int:
        self.settimeout(self.deadline.left())
        count = super().recv_into(buffer, nbytes, flags)
        self.most -= count
        if self.most < 0:
            raise OSError(errno.EMSGSIZE, "its answer is too long")
        return count

    def sendall(self, data: Any, flags: int = 0) -> None:
        self.settimeout(self.deadline.left())
        super().sendall(data, flags)


class Secured(Connection, ssl.SSLSocket):  # type: ignore[misc]  # typeshed names arguments differently
    """The same by TLS."""


def secured(connection: Connection, host: str, context: ssl.SSLContext | None = None) -> Secured:
    """TLS over a connection, with a peer that proves to be this host. `context` by trust(); by default it trusts the
    authorities of this machine. Raises OSError."""
    connection.settimeout(connection.deadline.left())
    encrypted: Secured = (context or _context()).wrap_socket(connection, server_hostname=host)  # type: ignore[assignment]
    encrypted.bound(connection.deadline, connection.most)
    return encrypted


def trust(authority: str | None = None, certificate: str | None = None, key: str | None = None) -> ssl.SSLContext:
    """A context that trusts the authorities in a file, or those of this machine, and shows a certificate if there is
    one. Raises OSError."""
    context = ssl.create_default_context(cafile=authority)
    if certificate:
        context.load_cert_chain(certificate, key)
    context.sslsocket_class = Secured
    return context


_context = cache(trust)


def connect(host: str, port: int, deadline: Deadline, most: int = HEAD) -> Connection:
    """A connection to the first address that accepts one. Raises OSError."""
    addresses, refused = _addresses(host, port, deadline), OSError(errno.EADDRNOTAVAIL, f"{host} has no address")
    for index, (family, kind, protocol, _, address) in enumerate(addresses):
        connection = Connection(family, kind, protocol)
        connection.bound(deadline, most)
        try:
            connection.settimeout(deadline.left() / (len(addresses) - index))
            connection.connect(address)
            return connection
        except OSError as error:
            connection.close()
            refused = error
    raise refused


@contextlib.contextmanager
def answer(
    url: str,
    deadline: Deadline,
    most: int = HEAD,
    body: bytes | None = None,
    headers: Mapping[str, str] | None = None,
    trusted: ssl.SSLContext | None = None,
) -> Iterator[http.client.HTTPResponse]:
    """The answer of an http:// or https:// URL to a GET, or to a POST of `body`, after its head; read its body within
    the block. `trusted` by trust(). Raises OSError for any failure, also for something that is not HTTP."""
    host, port = place_of(url, *PORTS)
    parts = urlsplit(url)
    asked = http.client.HTTPConnection(host, port)
    path = (parts.path or "/") + (f"?{parts.query}" if parts.query else "")
    try:
        asked.sock = connection = connect(host, port, deadline, most)
        if parts.scheme == "https":
            asked.sock = secured(connection, host, trusted)
        asked.request("GET" if body is None else "POST", path, body, {"Connection": "close", **(headers or {})})
        with asked.getresponse() as response:
            yield response
    except OSError:  # of TLS some are ValueErrors, too
        raise
    except (http.client.HTTPException, ValueError) as error:
        raise OSError(f"{type(error).__name__}") from error
    finally:
        asked.close()


def place_of(url: str, *schemes: str) -> tuple[str, int]:
    """Host and port of a URL with one of these schemes, by default http and its port. Raises OSError."""
    schemes = schemes or ("http",)
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port, parts = None, None, None
    if not parts or parts.scheme not in schemes or not host:
        raise OSError(errno.EINVAL, f"it is not at a {schemes[0]}:// URL")
    return host, port or PORTS.get(parts.scheme, 80)


def _addresses(host: str, port: int, deadline: Deadline) -> list[Any]:
    """As getaddrinfo returns them, but before the deadline."""
    with contextlib.suppress(OSError):
        return socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_NUMERICHOST)
    with _lock:
        lookup = _lookups.get((host, port))
        if lookup is None:
            lookup = _lookups[host, port] = Future()
            threading.Thread(target=_look_up, args=(host, port, lookup), name="resolver", daemon=True).start()
    try:
        return lookup.result(deadline.left())
    except TimeoutError:
        raise TimeoutError(f"the look-up of {host} timed out") from None


def _look_up(host: str, port: int, lookup: Future[list[Any]]) -> None:
    try:
        addresses: list[Any] | OSError = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    except OSError as error:
        addresses = error
    except UnicodeError:
        addresses = OSError(errno.EINVAL, "it is not a host name")
    with _lock:
        del _lookups[host, port]
    if isinstance(addresses, OSError):
        lookup.set_exception(addresses)
    else:
        lookup.set_result(addresses)
