"""A socket beside the requests file: a command that changes the file notifies the loop, which then need not wait for
its file watcher.

A notification has no content, and a lost one does no harm, because the file is watched too.
"""

from __future__ import annotations

import contextlib
import os
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

NAME = "wakeup"


@contextlib.contextmanager
def _address(directory: Path) -> Iterator[str]:
    """The socket's address through an open directory: its own path may be longer than the allowed 107 bytes."""
    descriptor = os.open(directory, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield f"/proc/self/fd/{descriptor}/{NAME}"
    finally:
        os.close(descriptor)


def notify(directory: Path) -> None:
    """Notify the loop, if it listens."""
    with (
        contextlib.suppress(OSError),
        _address(directory) as address,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK) as sender,
    ):
        sender.sendto(b"!", address)


class Wakeup:
    """Calls `heard` for every notification, in a thread of its own, until stop()."""

    def __init__(self, directory: Path, heard: Callable[[], None]) -> None:
        self.directory, self.heard = directory, heard
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._stopped = False

    def start(self) -> None:
        """Replace a socket that a killed loop left; the caller owns the state directory. If something else is there,
        nothing is received, and the file watcher must do."""
        try:
            (self.directory / NAME).unlink(missing_ok=True)
            with _address(self.directory) as address:
                self._socket.bind(address)
            os.chmod(self.directory / NAME, 0o660)
        except OSError:
            return
        threading.Thread(target=self._listen, name="wakeup", daemon=True).start()

    def _listen(self) -> None:
        while not self._stopped:
            self._socket.recv(16)
            self.heard()

    def stop(self) -> None:
        self._stopped = True
        notify(self.directory)
