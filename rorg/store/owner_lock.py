"""Lets only one rorg at a time manage the containers of an owner id, even if someone has copied the state directory.

The lock is a file named by the owner id, outside of every state directory, with flock: the kernel releases it when its
holder dies, so no stale lock is ever left. An abstract socket would do the same without a file, but any service on the
host's network could take its name and keep rorg from starting. rorg in a container shares the lock with the host if it
has /run/rorg mounted, as the documentation says. Two machines that use one engine do not share it.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rorg.store.files import make_directory, open_private, read_state


class Held(Exception):
    """Another rorg holds the lock; `about` is its own description."""

    def __init__(self, about: Mapping[str, Any]) -> None:
        super().__init__("held")
        self.about = about


class OwnerLock:
    """The lock of one owner id, held from construction on."""

    def __init__(self, owner: str, about: Mapping[str, Any]) -> None:
        """Raises Held, and OSError if locking is not possible here."""
        self._path = _folder() / owner
        self._descriptor = self._take()
        os.truncate(self._descriptor, 0)
        os.write(self._descriptor, json.dumps(about).encode())

    def _take(self) -> int:
        while True:
            descriptor = open_private(self._path, os.O_RDWR)
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                # The previous holder may have removed the file after we opened it.
                if os.path.exists(self._path) and os.path.samestat(os.fstat(descriptor), os.stat(self._path)):
                    return descriptor
            except BlockingIOError:
                os.close(descriptor)
                raise Held(_read(self._path)) from None
            except OSError:
                os.close(descriptor)
                raise
            os.close(descriptor)

    def release(self) -> None:
        with contextlib.suppress(OSError):
            self._path.unlink()
        os.close(self._descriptor)


def _folder() -> Path:
    """The same folder for every rorg of this user in any environment. Raises OSError."""
    user = os.geteuid()
    if user == 0:
        folder = Path("/run/rorg/owners")
    else:
        own = Path(f"/run/user/{user}")
        folder = own / "rorg/owners" if own.is_dir() else Path(tempfile.gettempdir(), f"rorg-{user}")
    make_directory(folder, 0o700)
    if folder.stat().st_uid != user:
        raise PermissionError(f"{folder} belongs to another user")
    return folder


def _read(path: Path) -> Mapping[str, Any]:
    try:
        owner = json.loads(read_state(path))
    except (OSError, ValueError, RecursionError):
        return {}
    return owner if isinstance(owner, dict) else {}
