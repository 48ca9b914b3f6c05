"""Commands that rorg runs for an answer: how long one may take, and how much it may print, before it is ended."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import threading

from rorg.host.deadline import Deadline

MOST_OUTPUT = 256 << 10
"""Bytes that are read of one command. What prints more is none to ask (`cat /dev/zero`): it is ended."""
TURN = 0.2
"""Seconds until a command is ended after its `stop` is set."""
ENDING = 2.0
"""Seconds for which a command that was told to end is waited for."""
CHUNK = 1 << 16


class Exceeded(Exception):
    """A command may not go on: what its exit code is, and why."""

    def __init__(self, code: int, why: str) -> None:
        self.code, self.why = code, why
        super().__init__(why)


class Output:
    """What a command has printed, and what it may still take: `timeout` seconds from now on, MOST_OUTPUT bytes, and no
    more once `stop` is set."""

    def __init__(self, timeout: float, stop: threading.Event | None = None) -> None:
        self.timeout, self.stop = timeout, stop
        self._deadline, self._read = Deadline.within(timeout), bytearray()

    def left(self) -> float:
        """Seconds. Raises Exceeded."""
        try:
            return self._deadline.left()
        except TimeoutError:
            raise Exceeded(124, f"no end within {self.timeout:g} s") from None

    def turn(self) -> float:
        """Seconds to wait for more, before this is asked again. Raises Exceeded."""
        if self.stop is not None and self.stop.is_set():
            raise Exceeded(137, "rorg is being stopped")
        return min(TURN, self.left())

    def take(self, chunk: bytes) -> None:
        """Raises Exceeded."""
        self._read += chunk[: MOST_OUTPUT - len(self._read) + 1]
        if len(self._read) > MOST_OUTPUT:
            self._read.pop()
            raise Exceeded(137, f"it prints more than {MOST_OUTPUT >> 10} KiB")

    def text(self, why: Exceeded | None = None) -> bytes:
        """All that was read; for one that was ended, with a line that says why."""
        return bytes(self._read) if why is None else b"\n".join([*self._read.splitlines(), why.why.encode()])


def listen(child: subprocess.Popen[bytes], output: Output) -> int:
    """Reads what it prints until nobody holds that pipe any more and it has ended; its exit code. Raises Exceeded."""
    assert child.stdout is not None
    waiting, pipe = select.poll(), child.stdout.fileno()
    waiting.register(pipe, select.POLLIN)
    while True:
        if waiting.poll(output.turn() * 1000):
            chunk = os.read(pipe, CHUNK)
            if not chunk:
                break
            output.take(chunk)
    child.stdout.close()
    while True:
        with contextlib.suppress(subprocess.TimeoutExpired):
            return child.wait(output.turn())


def end(child: subprocess.Popen[bytes], number: int) -> None:
    """Signals a command that leads a session of its own, and all of its group; SIGKILL once it does not end by that."""
    for each in (number, signal.SIGKILL):
        if child.returncode is None:  # not waited for yet, so the number is still its own
            os.killpg(child.pid, each)
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(ENDING)
    if child.stdout:
        child.stdout.close()
