"""TLS of the server and of its calls to other machines: certificates from files that may change while it runs."""

from __future__ import annotations

import os
import ssl
from dataclasses import dataclass
from pathlib import Path

from rorg.errors import Invalid
from rorg.host.bounded_http import trust


@dataclass(eq=False)
class Tls:
    """TLS by PEM files: the server's certificate and key, the authorities that sign client certificates, and the lists
    (CRL) of the certificates that they have revoked. Raises Invalid if they cannot be read at the start."""

    certificate: Path
    key: Path
    authority: Path
    revoked: Path | None = None

    def __post_init__(self) -> None:
        self._seen, self.context = self._stamps(), self._made()
        self.client = self._calling()

    def renew(self) -> bool:
        """Whether the files have changed since the last call; then the context is a new one. Raises Invalid if they
        cannot be read; then the context stays."""
        stamps = self._stamps()
        if stamps == self._seen:
            return False
        self._seen = stamps
        self.context, self.client = self._made(), self._calling()
        return True

    def _calling(self) -> ssl.SSLContext:
        """A context by which this rorg calls others, with the same certificate and authority. Raises Invalid."""
        try:
            context = trust(str(self.authority), str(self.certificate), str(self.key))
        except (OSError, ssl.SSLError) as error:
            raise Invalid("call other machines", f"the certificates cannot be read: {error}") from error
        return context

    def _made(self) -> ssl.SSLContext:
        """A context that accepts clients by these files. Raises Invalid."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        try:
            context.load_cert_chain(self.certificate, self.key)
            context.load_verify_locations(self.authority)
            if self.revoked:
                context.load_verify_locations(self.revoked)
                context.verify_flags |= ssl.VERIFY_CRL_CHECK_LEAF
        except (OSError, ssl.SSLError) as error:
            raise Invalid("serve TLS", f"the certificates cannot be read: {error}") from error
        context.verify_mode = ssl.CERT_REQUIRED
        return context

    def _stamps(self) -> list[tuple[int, ...] | None]:
        """Differs when one of the files has changed."""
        return list(map(_stamp, (self.certificate, self.key, self.authority, self.revoked)))


def _stamp(path: Path | None) -> tuple[int, ...] | None:
    try:
        stat_result = os.stat(path) if path else None
    except OSError:
        return None
    return (stat_result.st_ino, stat_result.st_mtime_ns, stat_result.st_size) if stat_result else None
