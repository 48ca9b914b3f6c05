"""The frames in which the engine sends both outputs of a program: one byte for which output, three empty ones, four
with the length, then the data."""

from __future__ import annotations

import struct
from collections.abc import Iterator

HEAD = 8
STDOUT, STDERR = 1, 2


class Frames:
    """Takes a stream of frames apart as it comes; keeps none of it."""

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
