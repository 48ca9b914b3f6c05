"""An engine that outlives rorg: a sim engine in the harness's process, reached through a socket.

The log of the engine is what the promises are checked against: every call with the containers that were there after it.
"""

from __future__ import annotations

import contextlib
import pickle
import queue
import socket
import socketserver
import struct
import threading
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from proof.image_store import ImageStore

from rorg.core.observed import Container, FoundObjects
from rorg.engines.protocol import NONE, Usage
from rorg.errors import EngineError, Unreachable
from rorg.model.engines import Capabilities
from rorg.tools.sim.engine import EPOCH, SimEngine

CHANGES = ("create", "start", "stop", "signal", "remove", "pause", "resume", "rename", "update")
CHANGES += ("make_object", "remove_object", "build_image", "tag_image", "remove_image")
ASKS = ("exec", "ping")
MEMORY = 8 << 30
"""Bytes of memory of the machine."""


@dataclass(frozen=True)
class Entry:
    """A line of the log: a call of the engine, or what the harness did or saw."""

    at: float
    verb: str
    service: str = ""
    container: str = ""
    text: str = ""
    containers: Mapping[str, Container] = field(default_factory=dict)
    """After it."""

    def __str__(self) -> str:
        states = " ".join(f"{c.service}:{c.id[-4:]}={c.state}" for c in self.containers.values())
        return f"{self.at:7.3f} {self.verb:8} {self.service:9} {self.container[-4:]:4} {self.text}  [{states}]"


class Log:
    """What happened, in order."""

    def __init__(self) -> None:
        self.entries: list[Entry] = []
        self._begin = time.monotonic()

    def add(self, verb: str, service: str = "", container: str = "", text: str = "", **more: Any) -> None:
        self.entries.append(Entry(time.monotonic() - self._begin, verb, service, container, text, **more))

    def __str__(self) -> str:
        return "\n".join(map(str, self.entries))


class EngineWorld:
    """The sim engine of one case, with the log of its calls."""

    def __init__(self, owner: str, answers: Mapping[tuple[str, ...], tuple[int, bytes]]) -> None:
        self.sim = SimEngine(owner, lambda: time.time() - EPOCH)
        self.sim.answers.update(answers)
        self.log, self.lock = Log(), threading.RLock()
        self.images = ImageStore(lambda: {self.made_from.get(id, "") for id in self.sim.containers})
        self.made_from: dict[str, str] = {}
        """Container -> reference of its image."""
        self.used = 0
        """Bytes of memory that programs outside rorg use, of MEMORY."""

    def call(self, verb: str, args: tuple[Any, ...], more: dict[str, Any]) -> Any:
        with self.lock:
            target = str(args[0]) if args else ""
            before = self.sim.containers.get(target)
            text = "again" if verb == "build_image" and self.images.find(target) else ""
            result = self._target(verb)(*args, **more)
            if verb in CHANGES or verb == "exec":
                made = self.sim.containers.get(result) if verb == "create" else before
                text = f"{result[0]}" if verb == "exec" else text
                name, id_ = (made.service, made.id) if made else ("", target)
                self.log.add(verb, name, id_, text, containers=dict(self.sim.containers))
            if verb == "create":
                self.made_from[result] = str(args[1].get("image", ""))
            return result

    def take_over(self, other: EngineWorld) -> None:
        """The images, and what uses memory."""
        self.images.images, self.made_from = dict(other.images.images), dict(other.made_from)
        self.images.skip(len(self.images.images))
        self.sim.needs.update(other.sim.needs)

    def _target(self, verb: str) -> Any:
        own = {"load": self.load, "usage": self.usage, "images": self.images.listed, "save_images": self.images.saved}
        return own.get(verb) or getattr(self.images if "image" in verb else self.sim, verb)

    def usage(self, containers: Sequence[Container]) -> dict[str, Usage]:
        return self.sim.usage(containers) if self.sim.needs else {}

    def load(self) -> dict[str, float]:
        """The machine's, as rorg.host.load.machine() returns it; nothing uses its CPU."""
        own = sum(self.sim.needs.get(c.service, (0, 0))[1] for c in self.sim.containers.values() if c.alive)
        memory = {"memory": self.used + own, "memory_total": MEMORY}
        return {"cpu_seconds": 0.0, "cores": 4, **memory, "cpu_some": 0.0, "memory_some": 0.0}


def send(connection: socket.socket, value: Any) -> None:
    data = pickle.dumps(value)
    connection.sendall(struct.pack("!I", len(data)) + data)


def receive(connection: socket.socket) -> Any:
    size = struct.unpack("!I", _read(connection, 4))[0]
    return pickle.loads(_read(connection, size))


def _read(connection: socket.socket, size: int) -> bytes:
    data = b""
    while len(data) < size:
        piece = connection.recv(size - len(data))
        if not piece:
            raise ConnectionError("the other end has gone")
        data += piece
    return data


class EngineServer(socketserver.ThreadingUnixStreamServer):
    """Serves whatever is `world`: the harness puts another one there for each case."""

    daemon_threads = True
    request_queue_size = 64

    def __init__(self, path: Path, world: EngineWorld) -> None:
        self.world = world
        path.unlink(missing_ok=True)
        super().__init__(str(path), Handler)
        threading.Thread(target=self.serve_forever, args=(0.05,), daemon=True).start()

    def handle_error(self, *_: object) -> None:
        """The other end was killed."""


class Handler(socketserver.BaseRequestHandler):
    server: EngineServer

    def handle(self) -> None:
        world = self.server.world
        with contextlib.suppress(ConnectionError, OSError):
            while True:
                verb, args, more = receive(self.request)
                if verb == "events":
                    return self.follow(world)
                try:
                    answer = True, world.call(verb, args, more)
                except EngineError as error:
                    answer = False, (error.what, error.why, error.remedy, error.kind)
                send(self.request, answer)

    def follow(self, world: EngineWorld) -> None:
        changes: queue.SimpleQueue[str] = queue.SimpleQueue()
        with world.lock:
            world.sim._followers.append(changes)
        try:
            send(self.request, "")
            while True:
                send(self.request, changes.get())
        finally:
            with contextlib.suppress(ValueError):
                world.sim._followers.remove(changes)


class RemoteEngine:
    """The engine that the killed rorg has: each call goes to the harness, and counts as an effect if it changes
    something."""

    name, local, address = "sim", False, ""
    capabilities = Capabilities()

    def __init__(self, path: str, owner: str, effects: Any) -> None:
        self.path, self.owner, self.effects = path, owner, effects
        self._own = threading.local()

    def _connect(self) -> socket.socket:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connection.connect(self.path)
        return connection

    def _call(self, verb: str, *args: Any, **more: Any) -> Any:
        counted = self.effects.effect(f"engine {verb} {str(args[0])[-12:]}") if verb in CHANGES else None
        with counted or contextlib.nullcontext():
            try:
                if not hasattr(self._own, "connection"):
                    self._own.connection = self._connect()
                send(self._own.connection, (verb, args, more))
                good, value = receive(self._own.connection)
            except OSError as error:
                raise Unreachable(verb, str(error), "") from error
        if not good:
            raise EngineError(*value)
        return value

    def ping(self) -> str:
        return str(self._call("ping"))

    def list(self, known: Mapping[str, Container] = NONE) -> list[Container]:
        return self._call("list")

    def inspect(self, container: str) -> Container | None:
        return self._call("inspect", container)

    def events(self, stop: threading.Event) -> Iterator[tuple[str, str]]:
        with self._connect() as connection:
            send(connection, ("events", (), {}))
            connection.settimeout(None)
            threading.Thread(target=self._end, args=(stop, connection), daemon=True).start()
            with contextlib.suppress(OSError):
                while not stop.is_set():
                    yield receive(connection), ""

    @staticmethod
    def _end(stop: threading.Event, connection: socket.socket) -> None:
        stop.wait()
        with contextlib.suppress(OSError):
            connection.shutdown(socket.SHUT_RDWR)

    def usage(self, containers: Sequence[Container]) -> dict[str, Usage]:
        return self._call("usage", list(containers))

    def create(
        self, name: str, spec: Mapping, labels: Mapping, before: str = "", defaults: Collection[str] = ()
    ) -> str:
        return self._call("create", name, dict(spec), dict(labels), before, tuple(defaults))

    def start(self, container: str) -> None:
        self._call("start", container)

    def stop(self, container: str, signal: str, grace: float) -> None:
        self._call("stop", container, signal, grace)

    def signal(self, container: str, name: str) -> None:
        self._call("signal", container, name)

    def remove(self, container: str, volumes: bool = False) -> None:
        self._call("remove", container, volumes)

    def pause(self, container: str) -> None:
        self._call("pause", container)

    def resume(self, container: str) -> None:
        self._call("resume", container)

    def rename(self, container: str, name: str) -> None:
        self._call("rename", container, name)

    def update(self, container: str, options: Mapping[str, Any]) -> None:
        self._call("update", container, dict(options))

    def find_objects(self, keys: Collection[str]) -> FoundObjects:
        return self._call("find_objects", tuple(keys))

    def object_events(self, stop: threading.Event) -> Iterator[None]:
        yield
        stop.wait()

    def make_object(self, kind: str, name: str, spec: Mapping[str, Any], labels: Mapping[str, str]) -> None:
        self._call("make_object", kind, name, dict(spec), dict(labels))

    def remove_object(self, kind: str, name: str) -> None:
        self._call("remove_object", kind, name)

    def log_lines(self, container: str, tail: int | None, since: float | None, whole: bool) -> Iterator[Any]:
        return iter(())

    def log_follow(self, container: str, place: str, reading: Any) -> Iterator[Any]:
        return iter(())

    def log_since(self, container: str, place: str) -> Iterator[tuple[bytes, str]]:
        return iter(())

    def exec(self, container: str, command: Sequence[str], timeout: float, stop: Any = None) -> tuple[int, bytes]:
        return self._call("exec", container, tuple(command), timeout)

    def close(self) -> None:
        """Each thread's connection ends with it."""
