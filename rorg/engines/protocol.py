"""What rorg asks of an engine: Engine, which an engine with real programs extends to RealEngine.

An engine must have create, start, stop, signal and remove, list and inspect. Everything else is optional:
`capabilities` says what it lacks, and an engine that inherits from Engine gets methods that refuse what it does not
define. Images, networks and volumes, and a server that may be down, are protocols of their own, because only some
engines have them.
"""

# ruff: noqa: ARG002 - what refuses everything uses no argument

from __future__ import annotations

import builtins
import threading
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Protocol, runtime_checkable

from rorg.core.observed import Container, FoundObjects
from rorg.engines.log_lines import LogLine, Reading
from rorg.errors import EngineError
from rorg.model.engines import Capabilities
from rorg.model.objects import Kind

LIST_EVERY = 1.0
"""Seconds between two lists of an engine without events."""
SIGNALLED = "signalled"
"""In place of a state: the container was sent a signal that ends programs."""


@dataclass(frozen=True, slots=True)
class Usage:
    """CPU seconds since the container began, and bytes of memory in use now, without the page cache."""

    cpu: float
    memory: int


NONE: Mapping[str, Container] = {}


class Lifecycle(Protocol):
    """Making, changing and ending containers."""

    name: str
    capabilities: Capabilities

    def create(
        self,
        name: str,
        spec: Mapping[str, Any],
        labels: Mapping[str, str],
        before: str = "",
        defaults: Collection[str] = (),
    ) -> str:
        """Make a container without starting it, and return its id. It takes over the unnamed volumes of `before`, an
        older container of the service. `defaults` are options of the spec that no manifest sets: an image's own value
        has precedence over them."""
        ...

    def start(self, container: str) -> None: ...

    def stop(self, container: str, signal: str, grace: float) -> None:
        """Send the signal, towards the end of the `grace` (seconds) SIGTERM, and SIGKILL when that is over; return when
        it has ended."""

    def signal(self, container: str, name: str) -> None:
        """Send a signal to the program of a running container, and do nothing else."""

    def remove(self, container: str, volumes: bool = False) -> None:
        """Remove a container; `volumes`: with its unnamed volumes, because the service ends with it."""

    def pause(self, container: str) -> None:
        raise unsupported(self.name, "pause", container)

    def resume(self, container: str) -> None:
        raise unsupported(self.name, "resume", container)

    def rename(self, container: str, name: str) -> None:
        raise unsupported(self.name, "rename", container)

    def update(self, container: str, options: Mapping[str, Any]) -> None:
        """Set live options in place."""
        raise unsupported(self.name, "update", container)


class Observation(Protocol):
    """The containers, their changes, and what they use."""

    def ping(self) -> str:
        """Return the engine's version. Raises Unreachable."""
        return "built in"

    def list(self, known: Mapping[str, Container] = NONE) -> builtins.list[Container]:
        """Return all containers of this owner. `known` has, by id, containers as they were seen while events were
        followed: the engine may return those of which it has nothing new to say as they are."""
        ...

    def inspect(self, container: str) -> Container | None:
        """Return one container; None if it is gone or has another owner."""
        ...

    def events(self, stop: Reading) -> Iterator[tuple[str, str]]:
        """Yield the changes of our containers as (id, new state): "" for a state that only inspect() can tell,
        SIGNALLED for a signal that ends programs, and ("", "") when everything must be listed, at the beginning of the
        stream, or every LIST_EVERY seconds from an engine without events. Ends when `stop` is set; raises Unreachable
        when the stream breaks."""
        yield "", ""
        while not stop.wait(LIST_EVERY):
            yield "", ""

    def usage(self, containers: Sequence[Container]) -> dict[str, Usage]:
        """By container id, without those that do not run; empty for an engine on another machine."""
        return {}


class ManagedNodes(Protocol):
    """Changes the state of managed nodes of ROS 2. Raises EngineError if a node refuses, fails or does not answer."""

    def activate(self, container: str, domain: int, nodes: Sequence[str]) -> None: ...

    def deactivate(self, container: str, domain: int, nodes: Sequence[str]) -> None: ...


class Pinger(Protocol):
    """Asks an engine whether it answers; for one thread."""

    def ask(self) -> None:
        """Return within seconds. Raises Unreachable."""

    def close(self) -> None: ...


@runtime_checkable
class Daemon(Protocol):
    """An engine that is a program of its own, which can be stopped or stuck."""

    address: str
    local: bool

    def pinger(self) -> Pinger: ...


@runtime_checkable
class Images(Protocol):
    """An engine that makes containers from images. Errors as those of Engine."""

    def missing_images(self, references: Collection[str]) -> set[str]:
        """Return those of these that are not on the engine's machine, so that no container can be made from them."""

    def images(self) -> builtins.list[dict[str, Any]]:
        """Return all images with their use of the disk, in Docker's form: Size and SharedSize (bytes), and Containers,
        the number of containers made from them. Takes long if there are many."""

    def remove_image(self, reference: str) -> None:
        """Remove a reference, and with the last one the image. Raises EngineError if something is made from it."""

    def save_images(self, references: Collection[str]) -> AbstractContextManager[Iterator[bytes]]:
        """Return the blocks of an archive of these images, within the context."""

    def load_images(self, archive: IO[bytes]) -> int:
        """Take the images of an archive, and return their number. Raises EngineError if it is none."""


@runtime_checkable
class Objects(Protocol):
    """An engine that makes networks and volumes. Errors as those of Engine."""

    def find_objects(self, keys: Collection[str]) -> FoundObjects:
        """Return all of this owner, and everything whose name is one of these `keys`."""

    def object_events(self, stop: Reading) -> Iterator[None]:
        """Yield once when the stream begins, and for each network or volume that comes or goes; see events()."""

    def make_object(self, kind: Kind, name: str, spec: Mapping[str, Any], labels: Mapping[str, str]) -> None:
        """Make a network or volume. Raises EngineError if one with this name exists."""

    def remove_object(self, kind: Kind, name: str) -> None:
        """Remove one of this owner, if it still exists. Raises EngineError of kind `in_use` while anything uses it, and
        of kind `foreign` if it has another owner."""


class Inspection(Protocol):
    """The inside of one container: its log, and commands."""

    name: str

    def log_lines(
        self,
        container: str,
        tail: int | None,
        since: float | None,
        whole: bool,
    ) -> Iterator[LogLine]:
        """Yield the last `tail` lines printed `since` (seconds since the epoch). The last one may have no text: then it
        only says where the log ends. `whole`: without a last line that is not complete yet."""
        raise unsupported(self.name, "read the logs of", container)

    def log_follow(self, container: str, place: str, reading: Reading) -> Iterator[LogLine]:
        """Yield lines from a place on ("" for the oldest that is kept), as they come, until the current run is over or
        the reading ends."""
        raise unsupported(self.name, "read the logs of", container)

    def log_since(self, container: str, place: str) -> Iterator[tuple[bytes, str]]:
        """Yield the output of the current run so far, from a place on ("" for its beginning), in pieces of some 64 KiB,
        each with the place after it. Lines that are shorter than a piece are whole."""
        raise unsupported(self.name, "read the logs of", container)

    def exec(
        self,
        container: str,
        command: Sequence[str],
        timeout: float,
        stop: threading.Event | None = None,
    ) -> tuple[int, bytes]:
        """Run a command inside and return its exit code and output. A command that takes longer than `timeout` seconds,
        prints more than MOST_OUTPUT bytes, or still runs when `stop` is set, is ended with everything that it started:
        then the code is 124, as of timeout(1), or 137, and the last line of the output says why."""
        raise unsupported(self.name, "run a command in", container)


class Access(Protocol):
    """A person inside one container: with a terminal, and with files. Relative paths inside begin at its working
    directory."""

    def attach(self, container: str, command: Sequence[str], terminal: bool, stdin: bool) -> int:
        """Run a command inside with this process's standard outputs, and its standard input if `stdin`. Return its exit
        code, 127 if there is no such program. `terminal`: it gets a terminal, and ours is in raw mode. The command ends
        with this process. Must be called from the main thread."""

    def fetch(self, container: str, path: str, place: Path) -> None:
        """Copy a file or directory out of it like cp -r: into `place` if that is a directory, otherwise to that name.
        Keeps modes and links, and writes nothing outside of `place`. Raises Invalid."""

    def put(self, container: str, source: Path, path: str) -> None:
        """Copy a file or directory into it, likewise. Raises Invalid."""


class Engine(Lifecycle, Observation, Inspection, Protocol):
    """Any thread may call any method. All raise Unreachable if the engine does not answer, and EngineError (with a
    stable `kind`) if it refuses. Only containers with our owner label are ever returned."""

    local: bool
    """Its processes are those of this machine. Otherwise no Container has a pid, and no process, file or port of this
    machine may be taken for one of the container."""
    address: str
    """Its address in the form of DOCKER_HOST; empty for one that is built in."""

    def close(self) -> None: ...


class RealEngine(Engine, Access, Protocol):
    """An engine with real programs, which a person can look into; errors as those of Engine."""

    owner: str
    """The instance whose containers these are."""


def unsupported(engine: str, what: str, container: str) -> EngineError:
    """The error of an operation that an engine does not have."""
    return EngineError(f"{what} {container[:12]}", f"the {engine} engine cannot do that", kind="unsupported")


TERM_TIME, TERM_SHARE = 2.0, 0.2
"""Seconds of the grace period, and part of it, that at most remain for SIGTERM."""
KILL_TIME = 10.0
"""Seconds within which a program has ended after SIGKILL, unless a device hangs."""


def stop_sequence(signal: str, grace: float) -> list[tuple[str, float]]:
    """Return the signals to send, each with the seconds since the first one that it may then take. One signal is
    not enough: roscpp as PID 1 ignores SIGTERM, and a shell in between swallows SIGINT, so the stop would leave a stale
    registration. So SIGTERM comes in the last part of the grace period, and SIGKILL when it is over, as with Docker."""
    kill = ("SIGKILL", grace + KILL_TIME)
    if signal in ("SIGTERM", "SIGKILL"):
        return [(signal, grace), kill]
    return [(signal, grace - min(TERM_TIME, grace * TERM_SHARE)), ("SIGTERM", grace), kill]
