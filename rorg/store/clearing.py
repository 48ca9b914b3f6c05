"""What is left of a robot that was taken down: nothing but the requests that are kept, and what is not rorg's."""

from __future__ import annotations

import contextlib
import shutil
from dataclasses import replace

from rorg.store.engine_record import NAME as ENGINE
from rorg.store.last_good import NAME
from rorg.store.learned_file import NAME as LEARNED
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
    LEARNED,
    SPARE,
)
LAST = ("instance", "instance.lock", ".requests.lock", "owner.json", "lock")
"""What says whose robot this is."""
FOLDERS = ("process", "run", "builds", "git")
SOCKETS = ("services", ".new", "rorg.sock")
"""Below the run directory, which may be one of the machine's."""


def clear(state: StateDir) -> None:
    """Removes all that rorg keeps of a robot. The caller owns it, and has seen that nothing of it runs. Directories of
    which somebody uses more stay, with that. Raises Invalid for what the disk refuses."""
    with state.usable():
        for path in (state.run / name for name in SOCKETS):
            shutil.rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
        for name in FOLDERS:
            shutil.rmtree(state.path / name, ignore_errors=True)
        left = RequestsFile(state.requests).change(lambda d: replace(d, down=False, purge=False), notify=False)
        if left == RequestsDocument():
            state.requests.unlink(missing_ok=True)
        known = {"instance"} if state.homes.exists() else set()  # containers to develop in carry it, and may be there
        gone = (*FILES, *(name for name in LAST if name not in known))
        for path in (*state.path.glob("journal.*"), *(state.path / name for name in gone)):
            path.unlink(missing_ok=True)
    for directory in (state.run, state.path):
        with contextlib.suppress(OSError):  # of the machine's, or somebody else's
            directory.rmdir()
