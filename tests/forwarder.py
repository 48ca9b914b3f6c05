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
                threading.Thread(target=self._pass, args=(client, engine, False), daemon=True).start()
                threading.Thread(target=self._pass, args=(engine, client, True), daemon=True).start()

    def _pass(self, here: socket.socket, there: socket.socket, answer: bool) -> None:
        with contextlib.suppress(OSError):
            while data := here.recv(1 << 16):
                there.sendall(re.sub(rb'"Pid":([1-9][0-9]*)', self._other, data) if answer and self.pid else data)
            there.shutdown(socket.SHUT_WR)

    def _other(self, found: re.Match[bytes]) -> bytes:
        """As long as before, so that the length of the answer stays true."""
        pid = str(self.pid).encode()
        assert len(pid) <= len(found[1])
        return b'"Pid":' + pid.rjust(len(found[1]))
