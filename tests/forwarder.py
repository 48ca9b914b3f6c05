"""An engine that seems to be on another machine: its unix socket reached through TCP."""

from __future__ import annotations

import contextlib
import re
import socket
import threading


class Forwarder:
    """Listens at a TCP port of this machine and passes everything on to a unix socket. With `pid`, every process that
    the engine names has this number: one of this machine that is nothing of the engine's."""

    def __init__(self, host: str, pid: int = 0) -> None:
        self.path, self.pid = host.removeprefix("unix://"), pid
        self.silent = False
        """Streams of events stay open and say nothing."""
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.host = f"tcp://127.0.0.1:{self.listener.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self.listener.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self.listener.accept()
                engine = socket.socket(socket.AF_UNIX)
                engine.connect(self.path)
                asked: list[bytes] = []
                threading.Thread(target=self._ask, args=(client, engine, asked), daemon=True).start()
                threading.Thread(target=self._answer, args=(engine, client, asked), daemon=True).start()

    def _ask(self, client: socket.socket, engine: socket.socket, asked: list[bytes]) -> None:
        """`asked` holds the path of the last request of the connection."""
        with contextlib.suppress(OSError):
            while data := client.recv(1 << 16):
                if found := re.match(rb"[A-Z]+ (?:/v[0-9.]+)?(/[^ ?]*)", data):
                    asked[:] = [found[1]]
                engine.sendall(data)
            engine.shutdown(socket.SHUT_WR)

    def _answer(self, engine: socket.socket, client: socket.socket, asked: list[bytes]) -> None:
        with contextlib.suppress(OSError):
            while data := engine.recv(1 << 16):
                if self.silent and asked == [b"/events"]:
                    continue
                client.sendall(re.sub(rb'"Pid":([1-9][0-9]*)', self._other, data) if self.pid else data)
            client.shutdown(socket.SHUT_WR)

    def _other(self, found: re.Match[bytes]) -> bytes:
        """As long as before, so that the length of the answer stays true."""
        pid = str(self.pid).encode()
        assert len(pid) <= len(found[1])
        return b'"Pid":' + pid.rjust(len(found[1]))
