"""Runs a command in a container with the standard input and outputs of this process: for people and for pipes."""

from __future__ import annotations

import contextlib
import http.client
import os
import re
import signal
import sys
import threading
import time
import uuid
from collections.abc import Iterator, Sequence

from rorg.engines.docker.answers import STDERR, STDOUT, Frames
from rorg.engines.docker.client import CHUNK, Client, Stream
from rorg.engines.docker.errors import Refused
from rorg.engines.docker.exec import MARK, STARTING, end, inspect

LOOK = 0.25
"""Seconds between two checks of the size of our terminal."""
NO_PROGRAM = re.compile(r"executable file not found|no such file or directory", re.I)
FAILED = b"OCI runtime exec failed"
"""How the message begins that engines such as Docker 20 send instead of the command's output."""
NOT_FOUND = 127
"""The exit code for a missing program, as of shells."""
PIPE = 128 + signal.SIGPIPE
"""The exit code of a program whose reader has gone, as of shells."""


class _NobodyReads(Exception):
    """The reader of our output has gone."""


def attach(
    client: Client,
    container: str,
    command: Sequence[str],
    *,
    terminal: bool,
    stdin: bool,
    local: bool,
    folder: str | None = None,
) -> int:
    """See Access.attach. `folder`: where it begins, if not in the container's working directory. Raises the client's
    errors."""
    mark = f"{MARK}={uuid.uuid4().hex}"
    said = {
        "Cmd": list(command),
        "AttachStdin": stdin,
        "AttachStdout": True,
        "AttachStderr": True,
        "Tty": terminal,
        "WorkingDir": folder or "",
        "Env": [mark, *([f"TERM={os.environ.get('TERM', 'xterm')}"] if terminal else [])],
    }
    made = str(client.post(f"/containers/{container}/exec", said)["Id"])
    try:
        failure = _talk(client, made, terminal, stdin)
        return NOT_FOUND if NO_PROGRAM.search(failure) else _exit_code(client, made)
    except Refused as no:
        if NO_PROGRAM.search(no.text):
            return NOT_FOUND
        raise
    except (_NobodyReads, KeyboardInterrupt, SystemExit) as why:  # the command has lost its user
        with contextlib.suppress(OSError, http.client.HTTPException, Refused):
            end(client, container, made, mark, local)
        if isinstance(why, _NobodyReads):
            return PIPE
        raise


def _talk(client: Client, made: str, terminal: bool, stdin: bool) -> str:
    """Pass input and output on until the command ends. Return what the engine sent instead of output if the command did
    not start."""
    frames, size, begun, failure = Frames(), _Size(client, made), False, ""
    with client.stream("POST", f"/exec/{made}/start", {"Tty": terminal, "Detach": False}, both_ways=stdin) as stream:
        if stdin:
            threading.Thread(target=_pass_on, args=(stream,), daemon=True, name="stdin").start()
        with raw_terminal() if terminal else contextlib.nullcontext():
            for chunk in stream.in_turns(size.turn if terminal else lambda: 60.0):
                for text in [chunk] if terminal else frames.texts(chunk):
                    if not begun and text.startswith(FAILED):
                        failure = text.decode(errors="replace")
                    else:
                        _print(STDOUT if terminal else frames.output, text)
                    begun = True
    if failure:
        _print(STDERR, failure.encode())
    return failure


def _print(output: int, text: bytes) -> None:
    """Write directly to our own output of the same number. Raises _NobodyReads."""
    try:
        while text:
            text = text[os.write(output, text) :]
    except OSError as error:
        raise _NobodyReads from error


def _pass_on(stream: Stream) -> None:
    """Pass on standard input until it ends, or the command does."""
    with contextlib.suppress(OSError):
        while chunk := os.read(0, CHUNK):
            stream.send(chunk)
        stream.end_of_input()


def _exit_code(client: Client, made: str) -> int:
    """The engine may know it only a moment after the output has ended."""
    deadline = time.monotonic() + STARTING
    while (code := inspect(client, made)["ExitCode"]) is None and time.monotonic() < deadline:
        time.sleep(0.02)
    return int(code or 0)


class _Size:
    """Keeps the size of the command's terminal the same as ours."""

    def __init__(self, client: Client, made: str) -> None:
        self._client, self._made = client, made
        self._told: os.terminal_size | None = None

    def turn(self) -> float:
        """Pass on a new size, and return the seconds until the next check."""
        size = os.get_terminal_size(0)
        if size != self._told:
            with contextlib.suppress(Refused):  # it has not started yet, or it has ended
                self._client.post(f"/exec/{self._made}/resize", h=size.lines, w=size.columns)
                self._told = size
        return LOOK


@contextlib.contextmanager
def raw_terminal() -> Iterator[None]:
    """Put our terminal into raw mode, in which it passes on every key, even Ctrl-C. Restore it afterwards, also when
    this process receives SIGTERM."""
    import termios
    import tty

    def told(number: int, _: object) -> None:
        sys.exit(128 + number)

    before, handler = termios.tcgetattr(0), signal.signal(signal.SIGTERM, told)
    try:
        tty.setraw(0, termios.TCSADRAIN)  # keeps keys that were typed meanwhile
        yield
    finally:
        termios.tcsetattr(0, termios.TCSADRAIN, before)
        signal.signal(signal.SIGTERM, handler)
