"""The address of rorg, and connections to it: a unix socket, or TCP with TLS and a certificate."""

from __future__ import annotations

import os
import socket
from typing import TYPE_CHECKING, Any

from rorg_client.errors import invalid

if TYPE_CHECKING:
    import ssl

LONGEST = 107
"""Bytes that the kernel allows in the path of a socket."""


def default_address() -> str:
    """RORG_SOCKET (set in containers that may request something), or RORG_ADDRESS, or the machine's own rorg."""
    found = os.environ.get("RORG_SOCKET") or os.environ.get("RORG_ADDRESS")
    if found:
        return found
    folder = os.environ.get("RORG_RUN_DIR") or (
        f"{os.environ['RORG_STATE_DIR']}/run" if os.environ.get("RORG_STATE_DIR") else "/run/rorg"
    )
    return f"{folder}/rorg.sock"


class Address:
    """`unix:///path`, a path, or `https://host:port`. The files for https are RORG_CA, RORG_CERT and RORG_KEY unless
    they are given."""

    def __init__(self, text: str = "", ca: str = "", cert: str = "", key: str = "") -> None:
        self.text = text or default_address()
        self.ca, self.cert, self.key = (
            given or os.environ.get(name, "")
            for given, name in ((ca, "RORG_CA"), (cert, "RORG_CERT"), (key, "RORG_KEY"))
        )
        scheme, found, rest = self.text.partition("://")
        self.path, self.host, self.port = "", "", 0
        if not found:
            self.path = self.text
        elif scheme == "unix":
            self.path = rest
        elif scheme == "https":
            host, _, port = rest.rstrip("/").rpartition(":")
            if not host or not port.isdigit():
                raise invalid(f"cannot reach rorg on {self.text}", "it names no port", "https://HOST:PORT")
            self.host, self.port = host.strip("[]"), int(port)
        else:
            raise invalid(
                f"cannot reach rorg on {self.text}",
                f"'{scheme}' is not a way to reach rorg",
                "unix:///PATH or https://HOST:PORT",
            )
        self._context: ssl.SSLContext | None = None

    def __str__(self) -> str:
        return self.text

    def tls(self) -> ssl.SSLContext:
        """A context with our certificate, for servers with a certificate of our authority."""
        if self._context is None:
            import ssl

            try:
                context = ssl.create_default_context(cafile=self.ca or None)
                if self.cert:
                    context.load_cert_chain(self.cert, self.key or None)
            except (OSError, ssl.SSLError) as error:
                raise invalid(
                    f"cannot reach rorg on {self.text}",
                    f"the certificates cannot be read: {error}",
                    "RORG_CA, RORG_CERT and RORG_KEY",
                ) from error
            self._context = context
        return self._context

    def connect(self, timeout: float | None) -> socket.socket:
        """A connection, made through the open directory of the socket if its path is too long."""
        if self.host:
            found = socket.create_connection((self.host, self.port), timeout)
            try:
                found.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                return self.tls().wrap_socket(found, server_hostname=self.host)
            except BaseException:
                found.close()
                raise
        found = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        try:
            found.settimeout(timeout)
            name, folder = self.place()
            try:
                found.connect(name)
            finally:
                if folder is not None:
                    os.close(folder)
            return found
        except BaseException:
            found.close()
            raise

    def place(self) -> tuple[str, int | None]:
        """(name to connect to, a directory to close afterwards)."""
        if len(os.fsencode(self.path)) <= LONGEST:
            return self.path, None
        flags: Any = os.O_PATH | os.O_DIRECTORY | os.O_CLOEXEC
        folder = os.open(os.path.dirname(os.path.abspath(self.path)), flags)
        return f"/proc/self/fd/{folder}/{os.path.basename(self.path)}", folder
