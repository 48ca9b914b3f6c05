"""Limits commands that rorg runs for an answer: how long one may take, and how much it may print."""

from __future__ import annotations

import contextlib
import os
import select
import signal
import subprocess
import threading

from rorg.host.deadline import Deadline

MOST_OUTPUT = 256 << 10
"""Bytes that are read of one command. One that prints more (`cat /dev/zero`) is no sensible question, and is ended."""
TURN = 0.2
"""Seconds until a command ends after its `stop` is set."""
ENDING = 2.0
"""Seconds to wait for a command after SIGTERM."""
CHUNK = 1 << 16


class Exceeded(Exception):
    """A command must end: with this exit code, for this reason."""

    def __init__(self, code: int, why: str) -> None:
        self.code, self.why = code, why
        super().__init__(why)


class Output:
    """The output of a command, and what it may still take: `timeout` seconds from now on, MOST_OUTPUT bytes, and
    nothing once `stop` is set."""

    def __init__(self, timeout: float, stop: threading.Event | None = None) -> None:
        self.timeout, self.stop = timeout, stop
        self._deadline, self._read = Deadline.within(timeout), bytearray()

    def left(self) -> float:
        """Seconds that are left. Raises Exceeded."""
        try:
            return self._deadline.left()
        except TimeoutError:
            raise Exceeded(124, f"no end within {self.timeout:g} s") from None

    def turn(self) -> float:
        """Seconds to wait for more, before calling this again. Raises Exceeded."""
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
        """All output; if the command was ended, with a last line that says why."""
        return bytes(self._read) if why is None else b"\n".join([*self._read.splitlines(), why.why.encode()])


def listen(child: subprocess.Popen[bytes], output: Output) -> int:
    """Read the output until its pipe is closed and the command has ended; return its exit code. Raises Exceeded."""
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
    """Send a signal to the group of a command that leads a session, and SIGKILL if that does not end it."""
    for each in (number, signal.SIGKILL):
        if child.returncode is None:  # not waited for yet, so the pid is still its own
            os.killpg(child.pid, each)
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(ENDING)
    if child.stdout:
        child.stdout.close()
