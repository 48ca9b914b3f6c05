"""Programs that listen at a port of this machine, and answer so that a patient asker never comes to an end."""

from __future__ import annotations

import contextlib
import itertools
import socket
import ssl
import threading
import xmlrpc.client
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

Say = Callable[[], Iterator[bytes]]
HEAD = b"HTTP/1.1 200 OK\r\nContent-Type: text/xml\r\n\r\n"
OPEN = b"<?xml version='1.0'?><methodResponse><params><param><value>"


def endless(begin: bytes, again: bytes) -> Say:
    return lambda: itertools.chain([begin], itertools.repeat(again))


def silent() -> Iterator[bytes]:
    """Accepts, and never answers."""
    threading.Event().wait(60)
    yield b""


def drip() -> Iterator[bytes]:
    """A byte now and then: no single read takes long."""
    yield b"HTTP/1.1 200 OK\r\nX-Drip: "
    while True:
        threading.Event().wait(0.2)
        yield b"x"


def said(text: bytes) -> Say:
    return lambda: iter([text])


def answer(*values: Any) -> Say:
    """The answer of a ROS master, or what it has for one."""
    return said(HEAD + xmlrpc.client.dumps(values, methodresponse=True, allow_none=True).encode())


LAUGHS = "".join(f'<!ENTITY a{n + 1} "{f"&a{n};" * 10}">' for n in range(8))
HTTP = {
    "silent": silent,
    "drip": drip,
    "continue": endless(b"", b"HTTP/1.1 100 Continue\r\n\r\n" * 1000),
    "headers": endless(b"HTTP/1.1 200 OK\r\n", b"X: " + b"x" * 60000 + b"\r\n"),
    "line": endless(b"HTTP/1.1 200 ", b"x" * 65536),
}
"""Before an answer has begun."""
XML = {
    "text": endless(HEAD + OPEN + b"<string>", b"x" * 65536),
    "values": endless(HEAD + OPEN + b"<array><data>", b"<value><i4>1</i4></value>" * 1000),
    "depth": endless(HEAD + OPEN, b"<array><data><value>" * 1000),
    "chunks": endless(HEAD.replace(b"\r\n\r\n", b"\r\nTransfer-Encoding: chunked\r\n\r\n"), b"1\r\nx\r\n" * 1000),
    "entities": said(
        HEAD + f'<!DOCTYPE m [<!ENTITY a0 "ha">{LAUGHS}]>'.encode() + OPEN + b"<string>&a8;</string></value></param>"
    ),
    "digits": said(HEAD + OPEN + b"<int>" + b"9" * 100000 + b"</int></value></param></params></methodResponse>"),
    "keys": said(
        HEAD + OPEN + b"<struct><member><name><array><data/></array></name><value/></member></struct>"
        b"</value></param></params></methodResponse>"
    ),
}
"""Answers to a call."""


class Host:
    """Answers each connection, asked or not, with what `say` gives; by TLS with `tls`."""

    def __init__(self, say: Say, tls: ssl.SSLContext | None = None, port: int = 0) -> None:
        self.say, self.tls, self.asked = say, tls, 0
        self._listener = socket.create_server(("127.0.0.1", port), backlog=100)
        self.port = self._listener.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}/"
        self._open: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                connection, _ = self._listener.accept()
                self.asked += 1
                self._open.append(connection)
                threading.Thread(target=self._answer, args=(connection,), daemon=True).start()

    def _answer(self, connection: socket.socket) -> None:
        with contextlib.suppress(OSError), self.tls.wrap_socket(connection, True) if self.tls else connection as asked:
            self.serve(asked)

    def serve(self, connection: socket.socket) -> None:
        connection.recv(65536)
        for text in self.say():
            connection.sendall(text)
        connection.shutdown(socket.SHUT_WR)
        while connection.recv(65536):  # closed with something unread, its answer would be lost
            pass

    def close(self) -> None:
        for each in (self._listener, *self._open):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()


def with_certificate(folder: Path, name: str) -> ssl.SSLContext:
    """The context of a server with a certificate that `rorg certificate` has made."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(folder / f"{name}.pem", folder / f"{name}.key")
    return context
