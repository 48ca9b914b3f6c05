"""The server: HTTP/1.1 on unix sockets, in its own thread, so that no caller ever delays the loop.

People have one socket, and each service that may request something has its own. The server knows the caller by its
socket, and on the main one by what the kernel says of the process at the other end (permissions.peer).
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
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import uvicorn

from rorg.api import limits
from rorg.api.app import make_app
from rorg.api.connection import Connection, Who
from rorg.api.cpu_share import Metered
from rorg.api.forwarding import Forwarded
from rorg.api.generations import NotBefore
from rorg.api.limits import Accounts
from rorg.api.listener import Listener
from rorg.api.operations import Operations
from rorg.api.permissions import Caller, group_id, peer
from rorg.api.read_routes import Quick
from rorg.api.secret_filter import Hiding
from rorg.api.sockets import BACKLOG, NAME, MachineSockets, ServiceSockets, file_of, listen, make_directories
from rorg.api.tls import Tls
from rorg.daemon.loop import Loop
from rorg.errors import Invalid
from rorg.store.state_dir import StateDir

FAREWELL = 2.0
"""Seconds that stop() waits for answers under way."""
LOOK = 0.5
"""Seconds between two checks for overdue connections."""
RESTORE = 5.0
"""Seconds between two checks whether the sockets are still there."""
MOST_FILES = 65536
"""Descriptors that this process asks for."""


class Server:
    """Serves the API of a robot on sockets in a directory, until stop()."""

    def __init__(self, operations: Operations, directory: Path, group: str = "rorg") -> None:
        self.operations, self.directory = operations, directory
        self.group = group_id(group)
        self._asyncio: asyncio.AbstractEventLoop | None = None
        self._event, self._over = asyncio.Event(), asyncio.Event()
        self.services = ServiceSockets(directory, self.group, self._listen, operations.recorder)
        self.machines = MachineSockets(directory, self.group, self._listen)
        self.accounts = Accounts(time.monotonic)
        self.listeners: set[Listener] = set()
        self.room = limits.MOST_CONNECTIONS
        self._broken: Exception | None = None
        """Why it could not start."""
        operations.next_pass = lambda: self._event
        self.app = make_app(operations)
        quick = Hiding(Quick(self.app, operations), operations.tree.masker, lambda: operations.catalog)
        self.config = uvicorn.Config(
            Forwarded(Metered(NotBefore(quick, operations), operations), operations, lambda: self.tcp and self.tcp[2]),
            http=Connection,
            loop="uvloop",
            log_config=None,
            access_log=False,
            lifespan="off",
            timeout_keep_alive=int(limits.IDLE),
            backlog=BACKLOG,
            ws="none",
            server_header=False,
            date_header=False,
        )
        self.uvicorn = uvicorn.Server(self.config)
        self._thread: threading.Thread | None = None
        self.tcp: tuple[str, int, Tls] | None = None

    # -- life --------------------------------------------------------------------------------------------------

    def start(self) -> None:
        """Starts; it listens when this returns. Raises Invalid."""
        logging.getLogger("uvicorn.error").setLevel(logging.CRITICAL)
        self.room = limits.room(_descriptors())
        make_directories(self.directory)
        main = self._main()
        self.operations.committer.start()
        started = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(main, started), name="api-server", daemon=True)
        self._thread.start()
        started.wait(30)
        if self._broken is not None or not started.is_set():
            self.operations.committer.stop()
            where = f"{self.tcp[0]}:{self.tcp[1]}" if self.tcp else str(self.directory / NAME)
            raise Invalid(f"serve on {where}", str(self._broken or "no answer within 30 s"), "another address")
        self.operations.on_decision(self.decided)
        self.app.state.manifests.recover()

    def end(self) -> None:
        """From now on every caller, also one that waits, gets "busy"; what was accepted is still done. May be called
        from a signal handler."""
        self.operations.ending = True
        if self._asyncio is not None:
            with contextlib.suppress(RuntimeError):
                self._asyncio.call_soon_threadsafe(self._turn)

    def stop(self) -> None:
        """Stops when all callers have their answers."""
        self.end()
        self.operations.committer.stop()
        deadline = time.monotonic() + FAREWELL
        asked = set(self.uvicorn.server_state.tasks)
        while not asked.isdisjoint(self.uvicorn.server_state.tasks) and time.monotonic() < deadline:
            time.sleep(0.005)
        self.operations.on_decision(lambda: None)
        if self._asyncio is not None:
            with contextlib.suppress(RuntimeError):
                self._asyncio.call_soon_threadsafe(self._over.set)
        if self._thread:
            self._thread.join(5)
        (self.directory / NAME).unlink(missing_ok=True)

    def _peer(self, connection: socket.socket | None, _: Any) -> Caller:
        return peer(connection, self.group)

    def _main(self) -> socket.socket:
        """The socket for people. Raises OSError."""
        made = listen(self.directory, self.directory / NAME, group=self.group)
        self._main_file = file_of(self.directory / NAME)
        return made

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
        loop.set_exception_handler(self._odd)
        self._end_main = self._listen(main, self._peer)
        if self.tcp:
            host, port, tls = self.tcp
            for family, *_, address in await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM):
                place = socket.create_server(address, family=family, backlog=BACKLOG)
                self._listen(place, _certified, context=tls.context)
        self.uvicorn.started = True
        started.set()
        self._look()
        self._restore()
        # Its main_loop() would wake ten times a second, which was half of rorg's CPU at rest.
        await self.uvicorn.on_tick(0)
        await self._over.wait()
        for listener in list(self.listeners):
            self._deafen(listener)
        for connection in list(self.uvicorn.server_state.connections):
            connection.shutdown()

    def _listen(
        self, place: socket.socket, who: Who, service: str = "", context: ssl.SSLContext | None = None
    ) -> Callable[[], None]:
        """Serves a socket, of one service or of anyone, until the function that this returns is called."""

        def make() -> asyncio.Protocol:
            made = Connection(self.config, self.uvicorn.server_state, {})
            made.who, made.accounts, made.left = who, self.accounts, self.left
            return made

        account = self.accounts.of_service(service) if service else None
        listener = Listener(place, make, self.left, account, context)
        self.listeners.add(listener)

        def end() -> None:
            self._deafen(listener)
            for connection in list(self.uvicorn.server_state.connections):
                if isinstance(connection, Connection) and connection.account is account:
                    connection.transport.abort()
            if account is not None:
                account.closed = True

        return end

    def _deafen(self, listener: Listener) -> None:
        self.listeners.discard(listener)
        listener.close()

    def left(self) -> int:
        """Connections for which there is room."""
        greeted = sum(len(listener.greeted) for listener in self.listeners)
        return self.room - greeted - len(self.uvicorn.server_state.connections)

    def _look(self) -> None:
        """Closes overdue connections, every LOOK seconds."""
        loop = asyncio.get_running_loop()
        now = loop.time()
        for connection in list(self.uvicorn.server_state.connections):
            if isinstance(connection, Connection) and connection.due < now:
                connection.transport.abort()
        self._renew_tls()
        loop.call_later(LOOK, self._look)

    def _restore(self) -> None:
        """Makes sockets again that someone has removed, as by wiping the run directory. Connections of people go on."""
        asyncio.get_running_loop().call_later(RESTORE, self._restore)
        with contextlib.suppress(OSError):  # otherwise at the next check
            if file_of(self.directory / NAME) != self._main_file:
                make_directories(self.directory)
                main = self._main()
                self._end_main()
                self._end_main = self._listen(main, self._peer)
                text = f"the socket in {self.directory} had been removed, and was made again"
                self.operations.recorder.event("socket-restored", text)
        self.services.restore()
        self.machines.restore()

    def _renew_tls(self) -> None:
        """Takes up changed TLS files. Connected clients must show their certificate again."""
        try:
            if self.tcp is None or not self.tcp[2].renew():
                return
        except Invalid as error:
            self.operations.recorder.event("tls", f"{error}; the previous certificates stay in use")
            return
        for listener in self.listeners:
            listener.context = self.tcp[2].context if listener.context else None
        for connection in list(self.uvicorn.server_state.connections):
            if isinstance(connection, Connection) and connection.who is _certified:
                connection.transport.abort()
        self.operations.recorder.event("tls", "the certificates, or the list of revoked ones, were read again")

    def _odd(self, _: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Reports errors outside of any call. Callers that hang up, or do not speak TLS, are not errors."""
        error = context.get("exception")
        if not isinstance(error, OSError):
            told = f"internal error of the server: {error or context.get('message')}"
            self.operations.recorder.when_new("server", told, "internal-error", told)

    def decided(self) -> None:
        """After a pass of the loop: wakes those who wait, and gives services the sockets that their manifests ask
        for."""
        if self._asyncio is None:
            return
        decision = self.operations.last_decision
        # The catalog of the pass contains what is withheld, which keeps its socket.
        services = decision.situation.desired.catalog.services if decision else {}
        declared = frozenset(name for name, service in services.items() if service.calls)
        with contextlib.suppress(RuntimeError):
            self._asyncio.call_soon_threadsafe(self._turn)
            if self.services.due(declared):
                self._asyncio.call_soon_threadsafe(self.services.serve, declared)
            if (machines := frozenset(self.operations.machines.links)) != self.machines.served.keys():
                self._asyncio.call_soon_threadsafe(self.machines.serve, machines)

    def _turn(self) -> None:
        self._event.set()
        self._event = asyncio.Event()

    def prepare(self, names: Iterable[str]) -> None:
        """Makes the directories that are mounted into containers, before a container is made."""
        self.services.prepare(names)


def _descriptors() -> int:
    """Descriptors that this process may have open, after raising the limit as far as the kernel allows."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    with contextlib.suppress(ValueError, OSError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, MOST_FILES) if hard > 0 else MOST_FILES, hard))
    return resource.getrlimit(resource.RLIMIT_NOFILE)[0]


def _certified(_: socket.socket | None, transport: Any) -> Caller:
    """A caller over TLS: its certificate was signed by the authority that rorg was given, so it is a developer."""
    certificate = transport.get_extra_info("peercert") or {}
    names = dict(pair for part in certificate.get("subject", ()) for pair in part)
    return Caller("developer", certificate=names.get("commonName", "unnamed")) if certificate else Caller()


def make_server(loop: Loop, state: StateDir, group: str) -> Server:
    """The API of a loop, on sockets below the state's run directory."""
    return Server(Operations(loop), state.run, group)
