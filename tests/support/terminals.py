"""A program on a pseudo-terminal."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import struct
import sys
import termios

from common import readable, wait_for


def environment(robot) -> dict[str, str]:
    return {
        **os.environ,
        "RORG_STATE_DIR": str(robot.state.path),
        "RORG_ENGINE": robot.kind,
        "TERM": "xterm",
        "PS1": "ready> ",
        "ENV": "",
    }


class Terminal:
    """A command on a terminal of its own, of 40 rows."""

    def __init__(self, robot, *words: str, cwd=".", columns=80, **more: str) -> None:
        self.seen = b""
        self.pid, self.fd = pty.fork()
        if self.pid == 0:
            fcntl.ioctl(0, termios.TIOCSWINSZ, struct.pack("HHHH", 40, columns, 0, 0))
            os.chdir(cwd)
            os.execve(sys.executable, [sys.executable, "-m", "rorg", *words], {**environment(robot), **more})

    def read(self) -> bool:
        if readable(self.fd):
            try:
                self.seen += os.read(self.fd, 65536)
            except OSError:  # the other side is closed
                return False
        return True

    def expect(self, pattern: bytes) -> None:
        try:
            wait_for(lambda: (self.read(), re.search(pattern, self.seen))[1], 30, f"{pattern!r}")
        except AssertionError as late:
            late.add_note(f"seen: {self.seen!r}")
            raise

    def type(self, text: bytes) -> None:
        self.seen = b""
        os.write(self.fd, text)

    def resize(self, rows: int, columns: int) -> None:
        fcntl.ioctl(self.fd, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))

    def end(self) -> int:
        def ended() -> tuple[int, int] | None:
            self.read()
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            return (pid, status) if pid else None

        code = os.waitstatus_to_exitcode(wait_for(ended, 30, "its end")[1])
        os.close(self.fd)
        return code
