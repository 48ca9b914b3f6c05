"""The unix sockets in the run directory: one for people, and one for each service that may call."""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

from rorg.api.connection import Who
from rorg.api.permissions import Caller, peer
from rorg.daemon.recorder import Recorder
from rorg.store.files import make_directory

NAME = "rorg.sock"
BACKLOG = 1024
"""Connections that wait to be accepted."""
RETRY = 5.0
"""Seconds until the next attempt, if a socket could not be made."""

Serve = Callable[[socket.socket, Who, str], Callable[[], None]]
"""Serves a socket, for the service of this name, until the function that it returns is called."""


def make_directories(directory: Path) -> None:
    """Makes the directories of the sockets. A service's socket is open to every user, because programs in containers
    run as any user; so other users of this machine must not reach it. A container mounts its own directory, regardless
    of what is above it."""
    make_directory(directory, 0o755)
    services = directory / "services"
    make_directory(services, 0o700)
    services.chmod(0o700)


def listen(directory: Path, path: Path, mode: int = 0o660, group: int | None = None) -> socket.socket:
    """A listening socket with this mode and group, which replaces one that a killed rorg left behind. It is made in a
    private directory and then moved, so that a link at its place is never followed; and bound through an open
    directory, because its own path may be longer than the 107 bytes allowed. Raises OSError."""
    made = directory / ".new"
    make_directory(made, 0o700)
    (made / NAME).unlink(missing_ok=True)
    listener = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    folder = os.open(made, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        listener.bind(f"/proc/self/fd/{folder}/{NAME}")
        os.chmod(made / NAME, mode)
        if group is not None:
            with contextlib.suppress(PermissionError):
                os.chown(made / NAME, -1, group)
        os.replace(made / NAME, path)
    except OSError:
        listener.close()
        raise
    finally:
        os.close(folder)
    listener.setblocking(False)
    listener.listen(BACKLOG)
    return listener


def file_of(path: Path) -> tuple[int, int]:
    """Which file is at a path; (0, 0) for none."""
    try:
        found = os.lstat(path)
    except OSError:
        return 0, 0
    return found.st_dev, found.st_ino


class MachineSockets:
    """A socket for each other machine of the robot, for people; what is asked there goes to that machine."""

    def __init__(self, directory: Path, group: int | None, listening: Serve) -> None:
        self.directory, self.group, self.listening = directory / "machines", group, listening
        self.served: dict[str, Callable[[], None]] = {}
        self._files: dict[str, tuple[int, int]] = {}

    def serve(self, names: frozenset[str]) -> None:
        """Serves exactly these machines. A socket that cannot be made is tried again with the next change."""
        for name in set(self.served) - names:
            self.served.pop(name)()
            (self.directory / f"{name}.sock").unlink(missing_ok=True)
        for name in sorted(names - set(self.served)):
            with contextlib.suppress(OSError):
                make_directory(self.directory, 0o755)
                path = self.directory / f"{name}.sock"
                listener = listen(self.directory, path, group=self.group)
                self._files[name] = file_of(path)
                asks = lambda connection, _, name=name: replace(peer(connection, self.group), at=name)  # noqa: E731
                self.served[name] = self.listening(listener, asks, "")

    def restore(self) -> None:
        """Make the sockets again that someone has removed."""
        lost = {n for n in self.served if file_of(self.directory / f"{n}.sock") != self._files[n]}
        declared = frozenset(self.served)
        for name in lost:
            self.served.pop(name)()
        self.serve(declared)


class ServiceSockets:
    """The sockets of services, as their manifests ask for them."""

    def __init__(
        self,
        directory: Path,
        group: int | None,
        listening: Serve,
        recorder: Recorder,
    ) -> None:
        self.directory, self.group, self.listening, self.recorder = directory, group, listening, recorder
        self.served: dict[str, Callable[[], None]] = {}
        """Service -> function that ends its socket."""
        self._files: dict[str, tuple[int, int]] = {}
        self._declared: frozenset[str] = frozenset()
        self._again = float("inf")
        """When to try again to make sockets that failed."""

    def due(self, declared: frozenset[str]) -> bool:
        """Whether there is something to do, if these services should have sockets."""
        if declared == self._declared and time.monotonic() < self._again:
            return False
        self._declared, self._again = declared, float("inf")
        return True

    def prepare(self, names: Iterable[str]) -> None:
        """Makes the directories that are mounted into containers, before a container is made."""
        for name in names:
            place = self.directory / "services" / name
            make_directory(place)
            place.chmod(0o755)  # programs in containers run as any user

    def serve(self, names: frozenset[str]) -> None:
        """Serves exactly these services. A socket that fails is reported, and tried again after a while."""
        for name in set(self.served) - names:
            self.served.pop(name)()
            shutil.rmtree(self.directory / "services" / name, ignore_errors=True)
        for name in sorted(names - set(self.served)):
            caller = Caller("service", service=name)
            try:
                self.prepare([name])
                # The mount is the permission; a program may run as any user in its container.
                listener = listen(self.directory, self._path(name), 0o666, self.group)
                self._files[name] = file_of(self._path(name))
                self.served[name] = self.listening(listener, lambda *_, caller=caller: caller, name)
            except OSError as error:
                self._again = time.monotonic() + RETRY
                told = f"{name} has no socket for requests: {error}"
                self.recorder.when_new(f"socket of {name}", str(error), "no-socket", told)

    def restore(self) -> None:
        """Make the sockets again that someone has removed."""
        lost = {name for name in self.served if file_of(self._path(name)) != self._files[name]}
        declared = frozenset(self.served)
        for name in lost:
            self.served.pop(name)()
        self.serve(declared)

    def _path(self, name: str) -> Path:
        return self.directory / "services" / name / NAME
