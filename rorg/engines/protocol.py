"""What every engine speaks, by use: Lifecycle, Observation and Inspection, which are an Engine, and Images where it has
any. One with real programs is a RealEngine, which has Access too."""

from __future__ import annotations

import builtins
import threading
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from rorg.core.found_objects import FoundObjects
from rorg.core.observed import Container
from rorg.engines.log_lines import LogLine, Reading
from rorg.model.objects import Kind


@dataclass(frozen=True, slots=True)
class Capabilities:
    """What an engine can do. What it cannot is said to the user, never passed over in silence."""

    isolation: bool
    """Containers with namespaces and images; else plain processes of this machine."""
    live_update: bool
    """Options can be changed in place."""
    events: str
    """`all` changes arrive as events; or only `exits`, other drift being found at the next resync."""
    log_times: bool = True
    """The engine knows when a line of a log was printed."""
    ignored_options: frozenset[str] = frozenset()
    """Container options that have no meaning here."""


@dataclass(frozen=True, slots=True)
class Usage:
    """Since the container began: CPU seconds; and the memory in use now, bytes, without the page cache."""

    cpu: float
    memory: int


NONE: Mapping[str, Container] = {}


class Lifecycle(Protocol):
    """Making, changing and ending containers."""

    def create(
        self,
        name: str,
        spec: Mapping[str, Any],
        labels: Mapping[str, str],
        before: str = "",
        defaults: Collection[str] = (),
    ) -> str:
        """Makes a container, not started, and returns its id. It gets the unnamed volumes of `before`, an older
        container of the service. `defaults` are options of the spec that nobody asked for: what an image says itself
        goes before them."""

    def start(self, container: str) -> None: ...
    def pause(self, container: str) -> None: ...
    def resume(self, container: str) -> None: ...
    def stop(self, container: str, signal: str, grace: float) -> None:
        """The signal, `grace` seconds, SIGTERM, 2 seconds, SIGKILL; returns when it has ended."""

    def signal(self, container: str, name: str) -> None:
        """Sends a signal to the program of a running container, nothing more."""

    def remove(self, container: str, volumes: bool = False) -> None:
        """`volumes`: with those that nobody named, since the service ends with it."""

    def rename(self, container: str, name: str) -> None: ...
    def update(self, container: str, options: Mapping[str, Any]) -> None:
        """Sets live options in place."""


class Observation(Protocol):
    """What is there, how it changes, and what it uses."""

    def ping(self) -> str:
        """The engine's version. Raises Unreachable."""

    def list(self, known: Mapping[str, Container] = NONE) -> builtins.list[Container]:
        """All containers of ours. Of `known`, by id, as they were seen while events were followed, those of which the
        engine has nothing new to say may be given as they are."""

    def inspect(self, container: str) -> Container | None:
        """One container of ours; None when it is gone or not ours."""

    def events(self, stop: threading.Event) -> Iterator[tuple[str, str]]:
        """Our containers as they change: (id, its new state, or "" where only a look can tell), and once ("", "") when
        the stream stands. Ends when `stop` is set; raises Unreachable when the stream breaks."""

    def usage(self, containers: Sequence[Container]) -> dict[str, Usage]:
        """By container id; those that do not run are left out, and all where the engine is on another machine."""


class Pinger(Protocol):
    """Asks an engine whether it answers; for one thread."""

    def ask(self) -> None:
        """Returns within seconds. Raises Unreachable."""

    def close(self) -> None: ...


@runtime_checkable
class Daemon(Protocol):
    """An engine that is a program of its own, which may be stopped or stuck."""

    address: str

    def pinger(self) -> Pinger: ...


@runtime_checkable
class Images(Protocol):
    """What containers are made from, where that is more than a name."""

    def missing_images(self, references: Collection[str]) -> set[str]:
        """Those of these from which no container can be made, since they are not on the engine's machine."""


@runtime_checkable
class Objects(Protocol):
    """Networks and volumes, where the engine makes any. Errors as those of Engine."""

    def find_objects(self, keys: Collection[str]) -> FoundObjects:
        """All of ours, and whatever is called as one of these `keys`."""

    def object_events(self, stop: threading.Event) -> Iterator[None]:
        """One for each network or volume that comes or goes, and one when the stream stands, as of events()."""

    def make_object(self, kind: Kind, name: str, spec: Mapping[str, Any], labels: Mapping[str, str]) -> None:
        """Makes a network or volume. Raises EngineError where one of that name is there."""

    def remove_object(self, kind: Kind, name: str) -> None:
        """Removes one of ours; what is gone is fine. Raises EngineError of kind `in_use` while anything uses it, and of
        kind `foreign` for what is not ours."""


class Inspection(Protocol):
    """What is inside one container."""

    def logs(self, container: str, follow: bool, tail: int | None) -> Iterator[bytes]:
        """Output of the container, standard error included; the last `tail` lines, then what comes when following. In
        pieces of 1 MiB at the most."""

    def log_lines(self, container: str, tail: int | None, since: float | None, whole: bool) -> Iterator[LogLine]:
        """The last `tail` lines that were printed `since` (seconds since the epoch), the last of them perhaps without
        text: it says where the log stands. `whole`: without a last line that is being written."""

    def log_follow(self, container: str, place: str, reading: Reading) -> Iterator[LogLine]:
        """Lines from a place on ("" for the beginning of what is kept), as they come, until the run of now is over or
        the reading is ended."""

    def log_since(self, container: str, place: str) -> Iterator[tuple[bytes, str]]:
        """Output of the run of now from a place on ("" for its beginning) to what there is now: in pieces of some 64
        KiB, of whole lines where these are shorter, each with the place after it."""

    def exec(
        self, container: str, command: Sequence[str], timeout: float, stop: threading.Event | None = None
    ) -> tuple[int, bytes]:
        """Runs a command inside and returns its exit code and output. One that takes longer than `timeout` seconds,
        prints more than MOST_OUTPUT bytes, or still runs when `stop` is set, is ended with all that it began: it gives
        124, as timeout(1) does, or 137, and a last line that says why."""


class Access(Protocol):
    """A person inside one container: with a terminal, and with files. Paths inside that are not absolute begin at its
    working directory."""

    def attach(self, container: str, command: Sequence[str], terminal: bool, stdin: bool) -> int:
        """Runs a command inside with this process's standard outputs, and with its standard input if `stdin`; returns
        its exit code, 127 where there is no such program. `terminal`: it has one, which is ours in raw mode. It ends
        with this process. Called from the main thread."""

    def fetch(self, container: str, path: str, place: Path) -> None:
        """Copies a file or a directory out of it, as cp -r: into `place` where that is a directory, else to that name.
        Modes and links are kept, and nothing is written beside `place`. Raises Invalid."""

    def put(self, container: str, source: Path, path: str) -> None:
        """Copies a file or a directory into it, likewise. Raises Invalid."""


class Engine(Lifecycle, Observation, Inspection, Protocol):
    """Every method may be called from any thread. They raise Unreachable when the engine does not answer, and
    EngineError (with a stable `kind`) when it says no. Only containers with our owner label are ever returned."""

    name: str
    capabilities: Capabilities
    local: bool
    """Its processes are those of this machine. Where they are not, no Container has a pid, and nothing of this machine
    may be taken for the container's: no process, no file, no port."""

    address: str
    """Where it is, in the form of DOCKER_HOST; empty for one that is built in."""

    def close(self) -> None: ...


class RealEngine(Engine, Access, Protocol):
    """An engine with real programs, which a person can look into; errors as those of Engine."""

    owner: str
    """The instance whose containers these are."""


TERM_GRACE = 2.0
"""Seconds between SIGTERM and SIGKILL."""


def stop_sequence(signal: str, grace: float) -> list[tuple[str, float]]:
    """Signals to send with the seconds to wait after each. roscpp as PID 1 ignores SIGTERM, and a shell in between
    swallows SIGINT, so one signal alone costs the whole grace period or leaves a stale registration."""
    if signal in ("SIGTERM", "SIGKILL"):
        return [(signal, grace), ("SIGKILL", 10.0)]
    return [(signal, grace), ("SIGTERM", TERM_GRACE), ("SIGKILL", 10.0)]
