"""A server that seems to be on another machine: reached through TCP, or through a socket of its own, on a line that can
be cut."""

from __future__ import annotations

import contextlib
import re
import socket
import struct
import threading
import weakref
from pathlib import Path


class Forwarder:
    """Passes everything on to a unix socket, or to a TCP port of this machine. It listens at a port of its own, or at
    the path `at`. With `pid`, every process that the engine names has this number: one of this machine that is nothing
    of the engine's."""

    def __init__(self, host: str, pid: int = 0, at: Path | None = None) -> None:
        self.path, self.pid = host.removeprefix("unix://"), pid
        self.reset = b""
        """A pattern: a connection that asks for a path which begins so is reset, and the server does not hear of it."""
        self.resets = 0
        self.silent = False
        """Streams of events stay open and say nothing."""
        self._whole, self._refuses = threading.Event(), False
        self._whole.set()
        self._open: weakref.WeakSet[socket.socket] = weakref.WeakSet()
        if at is None:
            self.listener = socket.create_server(("127.0.0.1", 0))
            self.host = f"tcp://127.0.0.1:{self.listener.getsockname()[1]}"
        else:
            self.listener = socket.socket(socket.AF_UNIX)
            self.listener.bind(str(at))
            self.listener.listen()
            self.host = f"unix://{at}"
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self.listener.close()

    def cut(self, refuses: bool) -> None:
        """Until mend(): either ends all connections and those that come, or lets them stay open without a word."""
        self._refuses = refuses
        self._whole.clear()
        for connection in list(self._open) if refuses else ():
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def mend(self) -> None:
        self._whole.set()

    def _connected(self) -> socket.socket | None:
        """To the server; None if it does not answer, or must not."""
        if self._refuses and not self._whole.is_set():
            return None
        try:
            if self.path.startswith("tcp://"):
                host, _, port = self.path.removeprefix("tcp://").partition(":")
                return socket.create_connection((host, int(port)))
            engine = socket.socket(socket.AF_UNIX)
            engine.connect(self.path)
            return engine
        except OSError:
            return None

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self.listener.accept()
                if (engine := self._connected()) is None:
                    client.close()
                    continue
                self._open.update((client, engine))
                asked: list[bytes] = []
                threading.Thread(target=self._ask, args=(client, engine, asked), daemon=True).start()
                threading.Thread(target=self._answer, args=(engine, client, asked), daemon=True).start()

    def _ask(self, client: socket.socket, engine: socket.socket, asked: list[bytes]) -> None:
        """`asked` holds the path of the last request of the connection."""
        with contextlib.suppress(OSError):
            while data := client.recv(1 << 16):
                if found := re.match(rb"[A-Z]+ (?:/v[0-9.]+)?(/[^ ?]*)", data):
                    asked[:] = [found[1]]
                    if self.reset and re.match(self.reset, found[1]):
                        self.resets += 1
                        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
                        engine.shutdown(socket.SHUT_RDWR)
                        client.close()
                        return
                self._whole.wait()
                engine.sendall(data)
            engine.shutdown(socket.SHUT_WR)

    def _answer(self, engine: socket.socket, client: socket.socket, asked: list[bytes]) -> None:
        with contextlib.suppress(OSError):
            while data := engine.recv(1 << 16):
                if self.silent and asked == [b"/events"]:
                    continue
                self._whole.wait()
                client.sendall(re.sub(rb'"Pid":([1-9][0-9]*)', self._other, data) if self.pid else data)
            client.shutdown(socket.SHUT_WR)

    def _other(self, found: re.Match[bytes]) -> bytes:
        """As long as before, so that the length of the answer stays true."""
        pid = str(self.pid).encode()
        assert len(pid) <= len(found[1])
        return b'"Pid":' + pid.rjust(len(found[1]))
