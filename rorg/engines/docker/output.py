"""Output of containers and of commands in them, as the engine sends it."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Iterator
from typing import Any

from rorg.engines.docker.client import Client

HEADER = 8
"""Bytes before each piece of either output: one for which, three empty, four with the length."""


def read_logs(client: Client, container: str, **query: Any) -> Iterator[bytes]:
    """Both outputs of a container, as they come."""
    terminal = client.get(f"/containers/{container}/json")["Config"].get("Tty")
    with client.stream("GET", f"/containers/{container}/logs", stdout=True, stderr=True, **query) as found:
        chunks = iter(found.read, b"")
        yield from chunks if terminal else payloads(chunks)


def payloads(chunks: Iterable[bytes]) -> Iterator[bytes]:
    """What both outputs say, of the pieces that an engine sends of a container without a terminal."""
    held = bytearray()
    for chunk in chunks:
        held += chunk
        while len(held) >= HEADER:
            (size,) = struct.unpack_from(">I", held, 4)
            if len(held) < HEADER + size:
                break
            yield bytes(held[HEADER : HEADER + size])
            del held[: HEADER + size]
