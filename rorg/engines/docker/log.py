"""Reads the output of a container, no faster than it is consumed. `path` is what has it: /containers/ID, or
/services/ID for all tasks of a Swarm service."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import nullcontext
from http.client import HTTPException
from typing import Any

from rorg.engines.docker.answers import Frames
from rorg.engines.docker.client import Client
from rorg.engines.docker.inspection import epoch_seconds
from rorg.engines.log_lines import LogLine, Reading
from rorg.model.units import nano_stamp

PIECE = 1 << 16
"""Bytes of lines that are searched at a time, and bytes of one line that are read."""
WAIT = 10.0
"""Seconds until the engine has found the next piece. It searches everything that it keeps."""


def since(client: Client, path: str, place: str) -> Iterator[tuple[bytes, str]]:
    """Lines from a time on (seconds since the epoch), in pieces, each with the time of its last line."""
    chunks = _chunks(client, path, WAIT, timestamps=True, since=place)
    messages = _lines(chunks) if _terminal(client, path) else _framed(chunks)
    piece, stamp = bytearray(), b""
    for message in messages:
        stamp, _, text = message.partition(b" ")
        piece += text
        if len(piece) >= PIECE:
            yield bytes(piece), str(epoch_seconds(stamp.decode()))
            piece.clear()
    yield bytes(piece), str(epoch_seconds(stamp.decode())) if stamp else place


def lines(client: Client, path: str, tail: int | None, since: float | None) -> Iterator[LogLine]:
    """The last `tail` lines since a time. If there are none, the last line of all says where the log ends."""
    place = ""
    asked: dict[str, Any] = {"since": since, "tail": "all" if tail is None else max(tail, 1)}
    for line in _stamped(client, path, WAIT, None, "", **asked):
        place = line.place
        if tail != 0:
            yield line
    if not place and since is not None:
        place = next((line.place for line in _stamped(client, path, WAIT, None, "", tail=1)), "")
    yield LogLine("", b"", place)


def follow(client: Client, path: str, place: str, reading: Reading) -> Iterator[LogLine]:
    """New lines after a place, until the container ends or the reading does."""
    time = place.partition("/")[0]
    seconds = f"{epoch_seconds(f'{time[:19]}Z'):.0f}.{time[20:29]}" if time else None
    try:
        yield from _stamped(client, path, None, reading, place, follow=True, since=seconds)
    except (OSError, HTTPException, ValueError):
        if not reading.is_set():
            raise


def _uniform(stamp: str) -> str:
    """A time of the engine in UTC with nine digits, as Docker writes it; Podman's has a zone, and fewer digits."""
    if len(stamp) == 30 and stamp.endswith("Z"):
        return stamp
    digits = re.search(r"\.(\d+)", stamp)
    return nano_stamp(
        int(epoch_seconds(re.sub(r"\.\d+", "", stamp))) * 10**9 + int(f"{digits[1] if digits else 0:<09}")
    )


def _stamped(
    client: Client, path: str, wait: float | None, reading: Reading | None, after: str, **asked: Any
) -> Iterator[LogLine]:
    """Lines after a place, which is TIME/COUNT: the caller has that many lines of that time."""
    known, _, count = after.partition("/")
    last, same = "", 0
    chunks = _chunks(client, path, wait, reading, timestamps=True, **asked)
    for message in _lines(chunks) if _terminal(client, path) else _framed(chunks):
        stamp, _, text = message.partition(b" ")
        time = _uniform(stamp.decode("ascii", errors="replace"))
        last, same = time, same + 1 if time == last else 1
        if time > known or (time == known and same > int(count)):
            yield LogLine(time, text, f"{time}/{same}")


def _chunks(
    client: Client, path: str, wait: float | None, reading: Reading | None = None, **asked: Any
) -> Iterator[bytes]:
    with (
        client.stream("GET", f"{path}/logs", None, wait, stdout=True, stderr=True, **asked) as stream,
        reading.closing(stream.close) if reading else nullcontext(),
    ):
        yield from iter(stream.read, b"")


def _terminal(client: Client, path: str) -> bool:
    """Whether it has a terminal: then its output comes without frames."""
    if path.startswith("/services/"):
        return bool(client.get(path)["Spec"]["TaskTemplate"]["ContainerSpec"].get("TTY"))
    return bool(client.get(f"{path}/json")["Config"]["Tty"])


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
