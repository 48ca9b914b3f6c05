"""How the engine sends what a program prints to both of its outputs: in frames of one byte for which output, three
empty ones, four with the length, and so many bytes."""

from __future__ import annotations

import struct
from collections.abc import Iterator

HEAD = 8
STDOUT, STDERR = 1, 2


class Frames:
    """Takes a stream apart as it comes; nothing of it is kept."""

    def __init__(self) -> None:
        self._head, self.left = b"", 0
        """How much of the frame under way is still to come."""
        self.output = STDOUT
        """To which output the program printed it: STDOUT or STDERR."""

    def texts(self, chunk: bytes) -> Iterator[bytes]:
        """What the program printed, of the next piece of the stream. After each text, `left` and `output` say of its
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
