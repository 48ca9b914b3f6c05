"""Lets one thread end the work of another, such as a command."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence

from rorg.errors import EngineError, NotReady
from rorg.host.commands import end

PATIENCE = 10.0
"""Seconds that a command may take to end after its output was read."""


class Cancellation:
    """Ends everything that is under way, and everything that starts afterwards."""

    def __init__(self) -> None:
        self._guard, self._called = threading.Lock(), False
        self._ends: list[Callable[[], object]] = []

    def cancel(self) -> None:
        """Cancels. Any thread may call it, any number of times."""
        with self._guard:
            self._called = True
            for end in self._ends:
                with contextlib.suppress(OSError):  # it has ended already
                    end()
            self._ends.clear()

    @contextlib.contextmanager
    def by(self, end: Callable[[], object]) -> Iterator[None]:
        """Calls `end` on cancel, which makes the block fail. Raises NotReady if it was cancelled before."""
        with self._guard:
            if self._called:
                end()
                raise NotReady("go on", "it is cancelled")
            self._ends.append(end)
        try:
            yield
        finally:
            with self._guard, contextlib.suppress(ValueError):
                self._ends.remove(end)


@contextlib.contextmanager
def run_command(
    what: str,
    command: Sequence[str],
    cancellation: Cancellation,
    *,
    stderr: int,
    cwd: str | None = None,
    env: Mapping[str, str] | None = None,
    remedy: str = "",
) -> Iterator[subprocess.Popen[bytes]]:
    """Runs a command, whose output the block reads. It has ended after the block. Raises EngineError if it cannot
    run."""
    try:
        process = subprocess.Popen(
            command,
            cwd=cwd,
            env=env,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=stderr,
            start_new_session=True,
        )
    except OSError as error:
        raise EngineError(what, f"{error.filename or command[0]}: {error.strerror}", remedy) from error
    assert process.stdout
    try:
        with cancellation.by(lambda: os.killpg(process.pid, signal.SIGKILL)):
            yield process
        process.stdout.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(PATIENCE)
    finally:
        end(process, signal.SIGTERM)
