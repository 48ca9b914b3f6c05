"""Callers that mean harm to the server: what they send, in processes and threads of their own."""

from __future__ import annotations

import contextlib
import socket
import threading
from collections.abc import Callable, Iterator


def asking(method: str, path: str, body: bytes = b"", **headers: str) -> bytes:
    """A whole request."""
    lines = [f"{method} {path} HTTP/1.1", "host: x", *(f"{k.replace('_', '-')}: {v}" for k, v in headers.items())]
    lines += ["content-type: application/json", f"content-length: {len(body)}"] if body else []
    return "\r\n".join([*lines, "", ""]).encode() + body


def connect(path: str) -> socket.socket:
    found = socket.socket(socket.AF_UNIX)
    found.settimeout(10)
    found.connect(path)
    return found


def answer(connection: socket.socket) -> bytes:
    """One answer with a length, or what there was until the end."""
    text = b""
    while b"\r\n\r\n" not in text:
        more = connection.recv(65536)
        if not more:
            return text
        text += more
    head, _, body = text.partition(b"\r\n\r\n")
    length = next((int(line[15:]) for line in head.lower().split(b"\r\n") if line.startswith(b"content-length:")), 0)
    while len(body) < length and (more := connection.recv(65536)):
        body += more
    return head + b"\r\n\r\n" + body


@contextlib.contextmanager
def flood(path: str, what: Callable[[int], bytes], threads: int = 8) -> Iterator[list[int]]:
    """Asks `what(number)` without a pause, on so many connections, hung up on or not; gives the statuses of answers."""
    over, statuses = threading.Event(), list[int]()

    def one(number: int) -> None:
        while not over.is_set():
            with contextlib.suppress(OSError), connect(path) as connection:
                connection.settimeout(2)
                while not over.is_set():
                    connection.sendall(what(number))
                    status = answer(connection)[9:12]
                    if not status:
                        break
                    statuses.append(int(status))
                    number += threads

    started = [threading.Thread(target=one, args=(number,), daemon=True) for number in range(threads)]
    for thread in started:
        thread.start()
    try:
        yield statuses
    finally:
        over.set()
        for thread in started:
            thread.join(30)
