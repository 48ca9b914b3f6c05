"""One message of HTTP, read from a socket without any help."""

from __future__ import annotations

import socket


def read_message(connection: socket.socket) -> tuple[bytes, bytes] | None:
    """Its head, and its body as far as it says how long that is; None where the connection ends before the head does.
    Raises OSError."""
    text = b""
    while b"\r\n\r\n" not in text:
        more = connection.recv(65536)
        if not more:
            return None
        text += more
    head, _, body = text.partition(b"\r\n\r\n")
    length = next((int(line[15:]) for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:")), 0)
    while len(body) < length and (more := connection.recv(65536)):
        body += more
    return head, body
