"""The server: HTTP/1.1 on unix sockets, in a thread of its own, so that no caller is ever in the way of the loop.

One socket for people and one for each service that may request something: who calls is known by the socket that is
called, and, on the main one, by the kernel's word for the process at the other end.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import resource
import shutil
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
from rorg.api.permissions import Caller, allow, group_id, peer
from rorg.daemon.loop import Loop
from rorg.errors import Invalid, RorgError
from rorg.store.state_dir import StateDir

NAME = "rorg.sock"
BACKLOG = 1024
MOST_CONNECTIONS = 8000
"""Requests at once beyond which the answer is 503."""
FAREWELL = 2.0
"""Seconds that the end waits for answers under way."""
RETRY = 5.0
"""Seconds until sockets that could not be made are tried again."""


class Quick:
    """Answers the one question that programs ask all the time, how a service is, without FastAPI's machinery, which
    takes most of the time. Whatever is not plain success is left to the application."""

    PREFIX = "/v1/services/"

    def __init__(self, app: Any, operations: Operations) -> None:
        self.app, self.operations = app, operations

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        name = (
            scope["path"][len(self.PREFIX) :]
            if scope.get("method") == "GET" and scope["path"].startswith(self.PREFIX)
            else "/"
        )
        if "/" not in name:
            try:
                allow(scope["state"]["caller"], "read")
                body = self.operations.service_text(name)
            except RorgError:
                pass
            else:
                headers = [(b"content-type", b"application/json"), (b"content-length", str(len(body)).encode())]
                await send({"type": "http.response.start", "status": 200, "headers": headers})
                await send({"type": "http.response.body", "body": body})
                return
        await self.app(scope, receive, send)


class Server:
    """Serves the API of a robot below a directory, until stop()."""

    def __init__(self, operations: Operations, directory: Path, group: str = "rorg") -> None:
        self.operations, self.directory = operations, directory
        self.group = group_id(group)
        self._asyncio: asyncio.AbstractEventLoop | None = None
        self._event = asyncio.Event()
        self._services: dict[str, asyncio.AbstractServer] = {}
        self._declared: frozenset[str] = frozenset()
        self._again = float("inf")
        """When to try sockets again that could not be made."""
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
        self.directory.mkdir(parents=True, exist_ok=True, mode=0o755)
        # Services' sockets are open to every user, since programs in containers run as any; so nobody else of this
        # machine may get as far as to them. A container has its own directory mounted, whatever stands above it.
        services = self.directory / "services"
        services.mkdir(exist_ok=True)
        services.chmod(0o700)
        main = self._listen(self.directory / NAME)
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
        for server in (*self.uvicorn.servers, *self._services.values()):
            server.close()
        for connection in list(self.uvicorn.server_state.connections):
            connection.shutdown()

    def _protocol(self, who: Callable[[socket.socket | None, Any], Caller]) -> Callable[[], asyncio.Protocol]:
        def make() -> asyncio.Protocol:
            made = Connection(self.config, self.uvicorn.server_state, {})
            made.who, made.open = who, self._open
            return made

        return make

    # -- sockets -----------------------------------------------------------------------------------------------

    def _listen(self, path: Path, mode: int = 0o660) -> socket.socket:
        """A listening socket of this mode and our group, in place of one that a killed rorg left behind. It is made
        where nobody else can reach it, and then moved: whatever lies at its place by then is never counted_on. Bound by
        way of an open directory, since a path of its own may be longer than the 107 bytes allowed."""
        made = self.directory / ".new"
        made.mkdir(mode=0o700, exist_ok=True)
        (made / NAME).unlink(missing_ok=True)
        found = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        folder = os.open(made, os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC)
        try:
            found.bind(f"/proc/self/fd/{folder}/{NAME}")
            os.chmod(made / NAME, mode)
            if self.group is not None:
                with contextlib.suppress(PermissionError):
                    os.chown(made / NAME, -1, self.group)
            os.replace(made / NAME, path)
        except OSError:
            found.close()
            raise
        finally:
            os.close(folder)
        found.setblocking(False)
        return found

    def decided(self) -> None:
        """After a pass: those who wait look again, and services have the sockets that their manifests ask for."""
        if self._asyncio is None:
            return
        declared = frozenset(n for n, s in self.operations.loop.tree.desired.catalog.services.items() if s.calls)
        with contextlib.suppress(RuntimeError):
            self._asyncio.call_soon_threadsafe(self._turn)
            if declared != self._declared or time.monotonic() >= self._again:
                self._declared, self._again = declared, float("inf")
                self._asyncio.call_soon_threadsafe(lambda: asyncio.ensure_future(self._serve_services(declared)))

    def _turn(self) -> None:
        self._event.set()
        self._event = asyncio.Event()

    def prepare(self, names: Iterable[str]) -> None:
        """The directories that are mounted into containers must be there before a container is made."""
        for name in names:
            (self.directory / "services" / name).mkdir(parents=True, exist_ok=True)

    async def _serve_services(self, names: frozenset[str]) -> None:
        for name in set(self._services) - names:
            self._services.pop(name).close()
            shutil.rmtree(self.directory / "services" / name, ignore_errors=True)
        for name in sorted(names - set(self._services)):
            caller = Caller("service", service=name)
            try:
                self.prepare([name])
                # Whatever user a program runs as inside its container, the mount is its right.
                listener = self._listen(self.directory / "services" / name / NAME, 0o666)
                self._services[name] = await asyncio.get_running_loop().create_server(
                    self._protocol(lambda *_, caller=caller: caller), sock=listener, backlog=BACKLOG
                )
            except OSError as error:
                self._again = time.monotonic() + RETRY
                self.operations.loop.recorder.when_new(
                    f"socket of {name}", str(error), "no-socket", f"{name} has no socket to request anything: {error}"
                )


def _certified(_: socket.socket | None, transport: Any) -> Caller:
    """A caller over TLS: its certificate was signed by the authority that rorg was given, so it is a developer."""
    found = transport.get_extra_info("peercert") or {}
    names = dict(pair for part in found.get("subject", ()) for pair in part)
    return Caller("developer", certificate=names.get("commonName", "unnamed")) if found else Caller()


def make_server(loop: Loop, state: StateDir, group: str) -> Server:
    """The API of a loop, on sockets below the state's run directory."""
    return Server(Operations(loop), state.run, group)
