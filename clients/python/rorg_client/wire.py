"""HTTP/1.1 as both clients speak it, without I/O: the bytes to send, and readers that say what they need next."""

from __future__ import annotations

from typing import Dict, Generator, NamedTuple, Tuple, TypeVar

LINE = -1
"""A reader yields this to get a line, or the number of bytes that it needs."""
LONGEST = 65536
"""Bytes of a line."""
T = TypeVar("T")
Reading = Generator[int, bytes, T]
Head = Tuple[int, Dict[str, str]]


class Answer(NamedTuple):
    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def last(self) -> bool:
        """Whether this connection takes no more calls."""
        return self.headers.get("connection", "").lower() == "close"


def asking(method: str, path: str, body: bytes | None, headers: dict[str, str]) -> bytes:
    """A whole request, as bytes."""
    lines = [f"{method} {path} HTTP/1.1", "host: rorg", *(f"{name}: {value}" for name, value in headers.items())]
    if body is not None:
        lines.append("content-type: application/json")
    if body is not None or method in ("PUT", "POST"):
        lines.append(f"content-length: {len(body or b'')}")
    return "\r\n".join([*lines, "", ""]).encode("latin-1") + (body or b"")


def _line() -> Reading[str]:
    data = yield LINE
    if not data.endswith(b"\n"):
        raise ConnectionError("the connection ended before the answer" if not data else "half an answer")
    return data.decode("latin-1").rstrip("\r\n")


def _bytes(count: int) -> Reading[bytes]:
    data = (yield count) if count else b""
    if len(data) < count:
        raise ConnectionError("the connection ended within the answer")
    return data


def reading_head() -> Reading[Head]:
    """Status and headers, in lower case."""
    version, _, rest = (yield from _line()).partition(" ")
    status = rest.partition(" ")[0]
    if not version.startswith("HTTP/1.") or not status.isdigit():
        raise ConnectionError("what answers does not speak HTTP")
    headers: dict[str, str] = {}
    while True:
        line = yield from _line()
        if not line:
            return int(status), headers
        name, _, value = line.partition(":")
        headers[name.strip().lower()] = value.strip()


def reading_chunk() -> Reading[bytes]:
    """The next chunk of a body; empty at its end."""
    size = (yield from _line()).partition(";")[0]
    try:
        count = int(size, 16)
    except ValueError:
        raise ConnectionError("what answers does not speak HTTP") from None
    data = yield from _bytes(count)
    yield from _line()
    return data


def reading_body(head: Head) -> Reading[bytes]:
    status, headers = head
    if status == 204:
        return b""
    if headers.get("transfer-encoding", "").lower() == "chunked":
        body = b""
        while True:
            piece = yield from reading_chunk()
            if not piece:
                return body
            body += piece
    return (yield from _bytes(int(headers.get("content-length", "0"))))


def reading() -> Reading[Answer]:
    """A whole answer."""
    head = yield from reading_head()
    body = yield from reading_body(head)
    return Answer(head[0], head[1], body)
