"""The server: HTTP/1.1 on unix sockets, in a thread of its own, so that no caller is ever in the way of the loop.

One socket for people and one for each service that may request something: who calls is known by the socket that is
called, and, on the main one, by the kernel's word for the process at the other end.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import resource
import socket
import ssl
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import uvicorn

from rorg.api.app import make_app
from rorg.api.connection import IDLE, Connection
from rorg.api.not_before import NotBefore
from rorg.api.operations import Operations
from rorg.api.permissions import Caller, group_id, peer
from rorg.api.quick import Quick
from rorg.api.sockets import BACKLOG, NAME, ServiceSockets, Who, listen, make_directories
from rorg.daemon.loop import Loop
from rorg.errors import Invalid
from rorg.store.state_dir import StateDir

MOST_CONNECTIONS = 8000
"""Requests at once beyond which the answer is 503."""
FAREWELL = 2.0
"""Seconds that the end waits for answers under way."""


class Server:
    """Serves the API of a robot below a directory, until stop()."""

    def __init__(self, operations: Operations, directory: Path, group: str = "rorg") -> None:
        self.operations, self.directory = operations, directory
        self.group = group_id(group)
        self._asyncio: asyncio.AbstractEventLoop | None = None
        self._event = asyncio.Event()
        self.services = ServiceSockets(directory, self.group, self._protocol, self._hang_up, operations.loop.recorder)
        self._open: Counter[str] = Counter()
        self._broken: Exception | None = None
        """Why it could not begin to serve."""
        self.app = make_app(operations, lambda: self._event)
        self.config = uvicorn.Config(
            NotBefore(Quick(self.app, operations), operations, lambda: self._event),
            http=Connection,
            loop="uvloop",
            log_config=None,
            access_log=False,
            lifespan="off",
            timeout_keep_alive=IDLE,
            limit_concurrency=MOST_CONNECTIONS,
            backlog=BACKLOG,
            ws="none",
            h11_max_incomplete_event_size=65536,
            server_header=False,
            date_header=False,
        )
        self.uvicorn = uvicorn.Server(self.config)
        self._thread: threading.Thread | None = None
        self.tcp: tuple[str, int, ssl.SSLContext] | None = None

    # -- life --------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Listens when it returns."""
        logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)
        _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        with contextlib.suppress(ValueError, OSError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, 65536) if hard > 0 else 65536, hard))
        make_directories(self.directory)
        main = listen(self.directory, self.directory / NAME, group=self.group)
        self.operations.committer.start()
        started = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(main, started), name="api-server", daemon=True)
        self._thread.start()
        started.wait(30)
        if self._broken is not None or not started.is_set():
            self.operations.committer.stop()
            where = f"{self.tcp[0]}:{self.tcp[1]}" if self.tcp else str(self.directory / NAME)
            raise Invalid(f"serve on {where}", str(self._broken or "no answer within 30 s"), "another address")
        self.operations.loop.decided = self.decided
        self.app.state.manifests.recover()

    def end(self) -> None:
        """From now on every caller, also those who wait, is told to come again; what was accepted is still done. May
        be called from a signal handler."""
        self.operations.ending = True
        if self._asyncio is not None:
            with contextlib.suppress(RuntimeError):
                self._asyncio.call_soon_threadsafe(self._turn)

    def stop(self) -> None:
        """Ends when everybody has their answer."""
        self.end()
        self.operations.committer.stop()
        deadline = time.monotonic() + FAREWELL
        while self.uvicorn.server_state.tasks and time.monotonic() < deadline:
            time.sleep(0.005)
        self.operations.loop.decided = lambda: None
        self.uvicorn.should_exit = self.uvicorn.force_exit = True
        if self._thread:
            self._thread.join(5)
        (self.directory / NAME).unlink(missing_ok=True)

    def _run(self, main: socket.socket, started: threading.Event) -> None:
        runner = asyncio.Runner(loop_factory=self.config.get_loop_factory())
        self._asyncio = runner.get_loop()
        self.config.load()
        self.uvicorn.lifespan = self.config.lifespan_class(self.config)
        with runner:
            try:
                runner.run(self._serve(main, started))
            except Exception as error:
                self._broken = error
            finally:
                started.set()

    async def _serve(self, main: socket.socket, started: threading.Event) -> None:
        loop = asyncio.get_running_loop()
        self.uvicorn.servers = [
            await loop.create_server(
                self._protocol(lambda connection, _: peer(connection, self.group)), sock=main, backlog=BACKLOG
            )
        ]
        if self.tcp:
            host, port, context = self.tcp
            self.uvicorn.servers.append(
                await loop.create_server(self._protocol(_certified), host, port, ssl=context, backlog=BACKLOG)
            )
        self.uvicorn.started = True
        started.set()
        await self.uvicorn.main_loop()
        for server in (*self.uvicorn.servers, *self.services.servers.values()):
            server.close()
        for connection in list(self.uvicorn.server_state.connections):
            connection.shutdown()

    def _protocol(self, who: Who) -> Callable[[], asyncio.Protocol]:
        def make() -> asyncio.Protocol:
            made = Connection(self.config, self.uvicorn.server_state, {})
            made.who, made.open = who, self._open
            return made

        return make

    def decided(self) -> None:
        """After a pass: those who wait look again, and services have the sockets that their manifests ask for."""
        if self._asyncio is None:
            return
        decision = self.operations.loop.decision
        # Of the pass, since it has what is withheld too: that stays as it was.
        services = decision.situation.desired.catalog.services if decision else {}
        declared = frozenset(name for name, service in services.items() if service.calls)
        with contextlib.suppress(RuntimeError):
            self._asyncio.call_soon_threadsafe(self._turn)
            if self.services.due(declared):
                self._asyncio.call_soon_threadsafe(lambda: asyncio.ensure_future(self.services.serve(declared)))

    def _hang_up(self, service: str) -> None:
        for connection in list(self.uvicorn.server_state.connections):
            if isinstance(connection, Connection) and connection.service == service:
                connection.transport.abort()

    def _turn(self) -> None:
        self._event.set()
        self._event = asyncio.Event()

    def prepare(self, names: Iterable[str]) -> None:
        """The directories that are mounted into containers must be there before a container is made."""
        self.services.prepare(names)


def _certified(_: socket.socket | None, transport: Any) -> Caller:
    """A caller over TLS: its certificate was signed by the authority that rorg was given, so it is a developer."""
    found = transport.get_extra_info("peercert") or {}
    names = dict(pair for part in found.get("subject", ()) for pair in part)
    return Caller("developer", certificate=names.get("commonName", "unnamed")) if found else Caller()


def make_server(loop: Loop, state: StateDir, group: str) -> Server:
    """The API of a loop, on sockets below the state's run directory."""
    return Server(Operations(loop), state.run, group)
