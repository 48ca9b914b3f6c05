"""Clears the state of a robot that was taken down. What stays: its owner id, that it is down, its history, requests
that are kept, and files of others."""

from __future__ import annotations

import contextlib
import shutil
from dataclasses import replace

from rorg.model.units import stamp
from rorg.store.engine_record import NAME as ENGINE
from rorg.store.last_good import NAME
from rorg.store.requests_document import RequestsDocument
from rorg.store.requests_file import SPARE, RequestsFile
from rorg.store.state_dir import StateDir

FILES = (
    "status.json",
    "manifest-change.json",
    ENGINE,
    "images.json",
    ".images.lock",
    "process-images.json",
    ".process-images.lock",
    "wakeup",
    NAME,
    "learned.json",  # of an earlier version; nothing reads it
    SPARE,
)
LOCKS = ("instance.lock", ".requests.lock", "owner.json", "lock")
FOLDERS = ("process", "run", "builds", "git")
SOCKETS = ("services", ".new", "rorg.sock")
"""Below the run directory, which may be shared by the machine."""


def clear(state: StateDir, now: float) -> None:
    """Remove what rorg keeps of a robot, and note that it is down since `now`, in seconds since the epoch. The owner id
    stays, because the robot's volumes carry it. So does the history, because the robot that comes up again is the same
    one; the requests file says if a person wants it forgotten. The caller owns the directory, and has checked that
    nothing of the robot runs. Directories with files of others stay. Raises Invalid if the disk refuses."""
    with state.usable():
        requests = RequestsFile(state.requests)
        requests.read()
        history = state.path.glob("journal.*") if requests.document.forget else ()
        for path in (state.run / name for name in SOCKETS):
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
        for name in FOLDERS:
            shutil.rmtree(state.path / name, ignore_errors=True)
        for path in (*history, *(state.path / name for name in FILES)):
            path.unlink(missing_ok=True)
        # Noted last: an rorg that is killed before this clears again.
        since = stamp(now)
        requests.change(lambda d: replace(d.up(), down=True, down_since=since), notify=False)
        for name in LOCKS:
            (state.path / name).unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # it is the machine's, or others use it
        state.run.rmdir()


def stays_down(state: StateDir, restarted: bool) -> str:
    """Since when a robot is down and stays down, ISO 8601 in UTC; empty if it may come up. An rorg that was
    `restarted`, by systemd or an engine, leaves it down; a person who runs rorg brings it up. The caller owns the
    directory. Raises Invalid."""
    file = RequestsFile(state.requests)
    file.read()
    since = file.document.down_since
    if since and not restarted:
        file.change(RequestsDocument.up, notify=False)
        return ""
    return since
