"""Where `rorg run` listens beside its socket, and by which certificates."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from rorg.errors import Invalid

if TYPE_CHECKING:
    from rorg.api.tls import Tls

Files = tuple[Path | None, Path | None, Path | None, Path | None]
"""Certificate, key, authority and list of revoked certificates."""


def files_of_machine(folder: Path, named: str) -> Files:
    """The files of this machine in a directory of certificates. Raises Invalid if there are none."""
    from rorg.host.certificates import Authority

    authority, host = Authority(folder), os.uname().nodename
    names = (named or os.environ.get("RORG_MACHINE") or host, host.partition(".")[0])
    found = next((authority.files(name) for name in names if authority.files(name)[0].exists()), None)
    if found is None:
        raise Invalid(f"use {folder}", f"there is no {names[0]}.pem", "`rorg certificate`, or --machine NAME")
    return (*found, authority.certificate, authority.revoked if authority.revoked.exists() else None)


def listening(listen: str, files: Files) -> tuple[str, int, Tls]:
    """Where to listen and how to know clients. Raises Invalid without the files that this takes."""
    from rorg.api.tls import Tls

    host, _, port = listen.rpartition(":")
    cert, key, authority, revoked = files
    if not (cert and key and authority and port.isdigit()):
        raise Invalid(
            f"listen on {listen}",
            "TCP is only served with TLS and client certificates",
            "HOST:PORT with --certificates DIR, or with --tls-cert, --tls-key and --tls-ca",
        )
    return host or "127.0.0.1", int(port), Tls(cert, key, authority, revoked)
