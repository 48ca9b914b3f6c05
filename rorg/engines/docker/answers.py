"""Reads the engine's answers: whole ones and lines up to a size, so that an endless answer does not take the robot's
memory; and the frames of a program's output."""

from __future__ import annotations

import json
import struct
from collections.abc import Iterator
from http.client import HTTPException, HTTPResponse
from typing import Any

MOST_ANSWER = 32 << 20
"""Bytes of one answer; a list of ten thousand containers has half of that."""
MOST_LINE = 4 << 20
"""Bytes of one line in a stream of JSON."""
MOST_ERROR = 16 << 10
"""Bytes of an error message; the rest is cut."""
HEAD = 8
"""Bytes in front of a frame: one for which output, three empty ones, four with the length of the data."""
STDOUT, STDERR = 1, 2


class Excessive(HTTPException):
    """The answer is longer than rorg reads."""


def whole(answer: HTTPResponse, host: str) -> bytes:
    """The whole answer. Raises Excessive."""
    text = answer.read(MOST_ANSWER + 1)
    _check("an answer", len(text), MOST_ANSWER, host)
    return text


def lines(answer: HTTPResponse, host: str, most: int | None = None) -> Iterator[bytes]:
    """Each line as it comes; `most`: bytes of all lines together, for an answer that ends. Raises Excessive."""
    taken = 0
    while line := answer.readline(MOST_LINE + 1):
        taken += len(line)
        _check("a line", len(line), MOST_LINE, host)
        _check("an answer", taken, taken if most is None else most, host)
        yield line


def refusal_text(answer: HTTPResponse) -> str:
    """Why the engine refuses."""
    said = answer.read(MOST_ERROR)
    try:
        return str(from_json(said)["message"])
    except (ValueError, KeyError, TypeError):
        return said.decode(errors="replace").strip() or answer.reason


def from_json(text: bytes) -> Any:
    """Parse JSON of the engine. Raises ValueError."""
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("the engine's JSON is nested too deep") from error


def _check(what: str, length: int, most: int, host: str) -> None:
    if length > most:
        raise Excessive(f"the engine at {host} sent {what} of more than {most >> 20} MiB")


class Frames:
    """Takes apart the frames in which the engine sends both outputs of a program, as they come; keeps none of it."""

    def __init__(self) -> None:
        self._head, self.left = b"", 0
        """Bytes of the current frame that are still to come."""
        self.output = STDOUT
        """The program's output that the current frame is from: STDOUT or STDERR."""

    def texts(self, chunk: bytes) -> Iterator[bytes]:
        """Yield the data in the next piece of the stream. After each text, `left` and `output` are those of its
        frame."""
        while chunk:
            if self.left:
                text, chunk = chunk[: self.left], chunk[self.left :]
                self.left -= len(text)
                yield text
                continue
            missing = HEAD - len(self._head)
            self._head, chunk = self._head + chunk[:missing], chunk[missing:]
            if len(self._head) == HEAD:
                self.output, self.left = struct.unpack(">BxxxI", self._head)
                self._head = b""
