"""The state directory: who owns this robot, and where its files are."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import re
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from rorg.errors import Invalid, Refused
from rorg.store.files import clear_leftovers, locked, make_directory, open_private, read_state, write_atomic
from rorg.store.owner_lock import Held, OwnerLock

MACHINE = Path("/var/lib/rorg")
"""State directory of the machine's robot."""
SERVER = "rorg run"
"""The owner of a robot that serves the API."""
INSTANCE = r"[A-Za-z0-9][A-Za-z0-9_.-]{0,127}"


def default_state_dir() -> Path:
    """/var/lib/rorg for root; for other users below XDG_STATE_HOME (by default ~/.local/state)."""
    if os.geteuid() == 0:
        return MACHINE
    return Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state") / "rorg"


class StateDir:
    """A state directory is one robot: its containers carry its instance id, and one rorg at a time owns it."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock: int | None = None
        self._owner_lock: OwnerLock | None = None

    def prepare(self) -> StateDir:
        """Create the directory. Raises Invalid if that is not allowed."""
        with self.usable():
            make_directory(self.path)
        return self

    @contextlib.contextmanager
    def usable(self) -> Iterator[None]:
        """Turn what the disk refuses in the block, or something else in the place of a file, into Invalid, with the
        path."""
        try:
            yield
        except OSError as error:
            raise Invalid(
                f"use the state directory {self.path}",
                f"{error.filename2 or error.filename or self.path}: {error.strerror or error}",
                "to fix or move what is there, or name another directory: --state-dir DIR, or RORG_STATE_DIR",
            ) from error

    @property
    def requests(self) -> Path:
        return self.path / "requests.yaml"

    @property
    def journal(self) -> Path:
        return self.path / "journal.db"

    @property
    def manifest_change(self) -> Path:
        """The change of a manifest that is being made."""
        return self.path / "manifest-change.json"

    @property
    def git(self) -> Path:
        """The repository that is followed, and its files."""
        return self.path / "git"

    @property
    def status(self) -> Path:
        return self.path / "status.json"

    @property
    def homes(self) -> Path:
        """Home directories in dev containers. They belong to their users, and stay when the robot is taken down."""
        return self.path / "dev"

    @property
    def run(self) -> Path:
        """Directory of rorg's sockets: RORG_RUN_DIR; by default /run/rorg for the machine's robot, otherwise `run` in
        here."""
        given = os.environ.get("RORG_RUN_DIR")
        if given:
            return Path(given)
        return Path("/run/rorg") if self.path == MACHINE else self.path.resolve() / "run"

    def instance(self, make_id: Callable[[], str] = lambda: uuid.uuid4().hex) -> str:
        """The instance id, made by `make_id()` the first time. Raises Invalid if it cannot be read: with a new one rorg
        would not recognize this robot's containers."""
        path = self.prepare().path / "instance"
        with self.usable(), locked(self.path / "instance.lock"):
            if not os.path.lexists(path):
                write_atomic(path, make_id() + "\n")
            instance_id = read_state(path).strip()
        if not re.fullmatch(INSTANCE, instance_id):
            raise Invalid(
                f"identify the robot of {self.path}",
                f"{path} holds no id",
                "to write there what the containers of this robot have in their label rorg.io/owner",
            )
        return instance_id

    def acquire(self, what: str) -> None:
        """Become the owner, or raise Refused that names the owner. Ends with release() or with the owner's death."""
        instance = self.instance()
        with self.usable():
            descriptor = open_private(self.path / "lock", os.O_RDWR)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(descriptor)
            owner = self.owner() or {}
            raise Refused(
                f"own {self.path}",
                f"{owner.get('what', 'another rorg')} (pid {owner.get('pid', '?')}) does",
                "to stop that one first, or use another --state-dir",
            ) from None
        self._lock = descriptor
        self._lock_owner(instance, {"pid": os.getpid(), "what": what, "state": str(self.path.resolve())})
        with self.usable():
            write_atomic(self.path / "owner.json", json.dumps({"pid": os.getpid(), "what": what}) + "\n", durable=False)
        with self.usable(), locked(self.requests.with_name(".requests.lock")):  # commands write it beside the owner
            clear_leftovers(self.path)

    def _lock_owner(self, instance: str, about: dict[str, Any]) -> None:
        """Raises Refused while an rorg on a copy of this directory manages the same containers."""
        try:
            self._owner_lock = OwnerLock(instance, about)
        except Held as held:
            self.release()
            other = held.about
            raise Refused(
                f"own {self.path}",
                f"{other.get('what', 'another rorg')} (pid {other.get('pid', '?')}) manages the same containers from "
                f"{other.get('state', 'another state directory')}: one of these directories is a copy of the other",
                "to stop that one first, or use another --state-dir for another robot",
            ) from None
        except OSError:  # no lock is possible here, which must not stop a robot
            return

    @property
    def held(self) -> bool:
        """Whether this process owns it."""
        return self._lock is not None

    def release(self) -> None:
        if self._owner_lock is not None:
            self._owner_lock.release()
            self._owner_lock = None
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    @property
    def readable(self) -> bool:
        """Whether this user can tell who owns it; also if it is missing, and so has no owner."""
        try:
            os.close(os.open(self.path / "lock", os.O_RDONLY | os.O_CLOEXEC))
        except PermissionError:
            return False
        except OSError:
            return True
        return True

    @property
    def served(self) -> bool:
        """Whether the owner serves the API, or is about to: not a command that does its work without a running rorg."""
        owner = self.owner()
        return owner is not None and owner.get("what", SERVER) == SERVER

    def owner(self) -> dict[str, Any] | None:
        """The current owner, {pid, what}; None if there is none."""
        try:
            descriptor = os.open(self.path / "lock", os.O_RDWR | os.O_CLOEXEC)
        except OSError:
            return None
        try:
            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
            return None
        except BlockingIOError:
            return read_json(self.path / "owner.json") or {}
        finally:
            os.close(descriptor)


def read_json(path: Path) -> dict[str, Any] | None:
    """The object in a JSON file, or None if it is missing or not complete."""
    try:
        value = json.loads(read_state(path))
    except (OSError, ValueError, RecursionError):
        return None
    return value if isinstance(value, dict) else None
