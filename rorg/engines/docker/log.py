"""Reading what a container printed, as it comes and no faster than it is used."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rorg.engines.docker.client import Client
from rorg.engines.docker.frames import Frames
from rorg.engines.docker.reading import epoch_seconds

PIECE = 1 << 16
"""Bytes of lines that are searched at once, and of one line that are looked at."""
WAIT = 10.0
"""Seconds until the engine has found the next of it. It looks through all that it keeps."""


def read(client: Client, container: str, follow: bool, tail: int | None) -> Iterator[bytes]:
    """The last `tail` lines, and then what comes."""
    chunks = _chunks(client, container, None if follow else WAIT, follow=follow, tail="all" if tail is None else tail)
    if _terminal(client, container):
        yield from chunks
    else:
        frames = Frames()
        for chunk in chunks:
            yield from frames.texts(chunk)


def since(client: Client, container: str, place: str) -> Iterator[tuple[bytes, str]]:
    """Lines from a time on (seconds since the epoch), in pieces, each with the time of its last line."""
    chunks = _chunks(client, container, WAIT, timestamps=True, since=place)
    messages = _lines(chunks) if _terminal(client, container) else _framed(chunks)
    piece, stamp = bytearray(), b""
    for message in messages:
        stamp, _, text = message.partition(b" ")
        piece += text
        if len(piece) >= PIECE:
            yield bytes(piece), str(epoch_seconds(stamp.decode()))
            piece.clear()
    yield bytes(piece), str(epoch_seconds(stamp.decode())) if stamp else place


def _chunks(client: Client, container: str, wait: float | None, **asked: Any) -> Iterator[bytes]:
    path = f"/containers/{container}/logs"
    with client.stream("GET", path, None, wait, stdout=True, stderr=True, **asked) as stream:
        yield from iter(stream.read, b"")


def _terminal(client: Client, container: str) -> bool:
    """Whether it has one: what it prints then comes as it is."""
    return bool(client.get(f"/containers/{container}/json")["Config"]["Tty"])


def _framed(chunks: Iterator[bytes]) -> Iterator[bytes]:
    """Each frame is a line, or 16 KiB of one, with its time in front."""
    frames, message = Frames(), bytearray()
    for chunk in chunks:
        for text in frames.texts(chunk):
            message += text[: PIECE - len(message)]
            if not frames.left:
                yield bytes(message)
                message.clear()


def _lines(chunks: Iterator[bytes]) -> Iterator[bytes]:
    line = bytearray()
    for chunk in chunks:
        for text in chunk.splitlines(keepends=True):
            line += text[: PIECE - len(line)]
            if text.endswith(b"\n"):
                yield bytes(line)
                line.clear()
