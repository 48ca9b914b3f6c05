"""One manifest written or deleted, and committed. It is noted on the disk before anything else, so that nothing stays
half done if rorg is killed: the next rorg finishes the change or undoes it, and reports which."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import stat
import time
from dataclasses import asdict, dataclass
from pathlib import Path

from rorg.host.git import commit, committed, wait_for_locks
from rorg.manifest.files import read_bytes, real
from rorg.store.files import clear_leftovers, make_directory, remove_durably, write_atomic
from rorg.store.state_dir import read_json


@dataclass(frozen=True, slots=True)
class ManifestChange:
    """A change that is about to happen. `before` and `after` are digests of the file's content, None if there is no
    file."""

    file: str
    """Relative to the tree."""
    before: str | None
    after: str | None
    message: str
    author: str
    person: bool = False
    """Whether the author is a person: then the login."""

    def place(self, root: Path) -> Path:
        """The file that holds its text: a link to another file of the tree stays a link. On deletion the link itself
        goes."""
        path = root / self.file
        return real(path) if path.is_symlink() and self.after is not None else path

    def carry_out(self, root: Path, note: Path, text: str | None) -> None:
        """Writes the file, or deletes it if there is no `text`, and commits it. Raises OSError; then the file is
        unchanged."""
        path = self.place(root)
        write_atomic(note, json.dumps(asdict(self)))
        try:
            remove_durably(root / self.file) if text is None else _write(path, text)
        except OSError:
            note.unlink()
            raise
        commit(root, path, self.author, self.message, self.person)
        note.unlink()


def recover(root: Path, note: Path) -> tuple[ManifestChange, str] | None:
    """Finishes or undoes the change that a killed rorg left behind: (the change, its outcome), or None without one. May
    wait for a git process that outlived its rorg."""
    change, begun = _noted(note)
    if change is None:
        note.unlink(missing_ok=True)
        return None
    path = change.place(root)
    clear_leftovers(path.parent)
    try:
        now = digest(read_bytes(path, root))
    except OSError:
        now = None
    if now == change.after:
        wait_for_locks(root, begun)
        done = committed(root, path) or commit(root, path, change.author, change.message, change.person)
        outcome = "finished" if done else "written, but not committed: git refuses"
    else:
        outcome = (
            "undone: nothing had been written"
            if now == change.before
            else "left as it is: someone has changed it since"
        )
    note.unlink()
    return change, outcome


def _noted(note: Path) -> tuple[ManifestChange | None, float]:
    """The change, and when it was noted, in seconds since the epoch."""
    try:
        change, begun = ManifestChange(**(read_json(note) or {})), note.stat().st_mtime
    except (OSError, TypeError):
        return None, time.time()
    whole = all(isinstance(text, str) for text in (change.file, change.message, change.author))
    return (change if whole else None), begun


def _write(path: Path, text: str) -> None:
    """An existing file keeps its owner and mode; a new one gets the owner of its folder, and everyone may read it."""
    if not path.parent.is_dir():
        make_directory(path.parent, 0o755)
        with contextlib.suppress(PermissionError):
            os.chown(path.parent, *_owner(path.parent.parent.stat()))
    try:
        before = path.stat()
    except OSError:
        write_atomic(path, text, mode=0o644, owner=_owner(path.parent.stat()))
    else:
        write_atomic(path, text, mode=stat.S_IMODE(before.st_mode), owner=_owner(before))


def _owner(stat_result: os.stat_result) -> tuple[int, int]:
    return stat_result.st_uid, stat_result.st_gid


def digest(content: bytes) -> str:
    """The digest of a manifest's text, which names the version that an edit began from."""
    return hashlib.sha256(content).hexdigest()[:16]
