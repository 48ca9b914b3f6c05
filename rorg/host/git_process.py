"""Runs git: as whose repository it is, for so long, and never with a question to anybody."""

from __future__ import annotations

import os
import pwd
import signal
import subprocess
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from rorg.host.commands import Exceeded, Output, end, listen

PATIENCE = 5.0
"""Seconds for a question to git."""
SAFE = ("-c", "safe.bareRepository=explicit", "-c", "core.fsmonitor=false")
"""Nothing that is committed to a tree is executed: a repository within it, with a configuration of its own, is none."""
CLEAN = {
    "PATH": "/usr/local/bin:/usr/bin:/bin",
    "LC_ALL": "C",
    "GIT_OPTIONAL_LOCKS": "0",
    "GIT_TERMINAL_PROMPT": "0",
}
"""The environment that every git has."""
MISSING = 127
"""The exit code of a git that is not there."""


class Owner(NamedTuple):
    """A user in whose name a program runs."""

    uid: int
    gid: int
    groups: tuple[int, ...]
    name: str
    """The number for one whom no file of this machine knows."""


@dataclass(frozen=True, slots=True)
class Said:
    """What git answered: exit code 0 for yes; 124 and 137 as commands have them that were ended."""

    code: int
    text: str

    @property
    def yes(self) -> bool:
        return self.code == 0


def repository(directory: Path) -> Path | None:
    """The `.git` that git finds for a directory, going up: a directory, or the file of a worktree. None outside of a
    repository."""
    here = Path(os.path.realpath(directory))
    return next((f / ".git" for f in (here, *here.parents) if os.path.lexists(f / ".git")), None)


def owner_of(path: Path) -> Owner | None:
    """Whom a repository belongs to; None where that is nobody else, or where we may not act for others anyway."""
    try:
        stat = os.lstat(path)
    except OSError:
        return None
    if os.geteuid() != 0 or stat.st_uid == 0:
        return None
    try:
        user = pwd.getpwuid(stat.st_uid)
    except KeyError:
        return Owner(stat.st_uid, stat.st_gid, (), str(stat.st_uid))
    return Owner(user.pw_uid, user.pw_gid, tuple(os.getgrouplist(user.pw_name, user.pw_gid)), user.pw_name)


def run_git(
    words: Sequence[str],
    owner: Owner | None = None,
    patience: float = PATIENCE,
    environment: Mapping[str, str] | None = None,
    errors: bool = False,
    stop: threading.Event | None = None,
) -> Said:
    """Runs it to its end, or for so many seconds, or until `stop` is set: then it is ended by SIGTERM, upon which it
    takes its locks away, and with it what it runs. `errors`: what it says of them is part of its answer.

    In the name of an `owner` nothing of their repository's configuration (hooks, filters, programs) is executed as
    root; git itself refuses repositories of others (safe.directory). Where the kernel does not let us (no CAP_SETUID)
    it runs as we do, and refuses. Only in our own name our own configuration counts."""
    own = os.environ.get("HOME", "") if owner is None else ""
    try:
        process = subprocess.Popen(
            ["git", *SAFE, *words],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT if errors else subprocess.DEVNULL,
            umask=0o022,  # what it writes is for whoever could read the tree before
            env={**CLEAN, **({"HOME": own} if own else {}), **(environment or {})},
            start_new_session=True,
            user=owner.uid if owner else None,
            group=owner.gid if owner else None,
            extra_groups=owner.groups if owner else None,
        )
    except PermissionError as error:
        if owner is not None:
            return run_git(words, None, patience, environment, errors, stop)
        return Said(MISSING, f"git: {error.strerror}")
    except OSError as error:
        return Said(MISSING, f"git: {error.strerror}")
    output = Output(patience, stop)
    try:
        code = listen(process, output)
        return Said(code, output.text().decode(errors="replace").strip())
    except Exceeded as why:
        end(process, signal.SIGTERM)
        return Said(why.code, why.why)
