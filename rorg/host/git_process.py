"""Runs git: as the owner of the repository, with a time limit, and without asking a user."""

from __future__ import annotations

import os
import pwd
import shlex
import signal
import subprocess
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import IO, NamedTuple

from rorg.host.commands import Exceeded, Output, end, listen

PATIENCE = 5.0
"""Seconds for a question to git."""
SAFE = ("-c", "safe.bareRepository=explicit", "-c", "core.fsmonitor=false")
"""Nothing that is committed to a tree is executed: a repository within it, with its own configuration, is ignored."""
CLEAN = {
    "PATH": "/usr/local/bin:/usr/bin:/bin",
    "LC_ALL": "C",
    "GIT_OPTIONAL_LOCKS": "0",
    "GIT_TERMINAL_PROMPT": "0",
}
"""The environment of every git."""
MISSING = 127
"""The exit code if git is missing."""


class Owner(NamedTuple):
    """A user as whom a program runs."""

    uid: int
    gid: int
    groups: tuple[int, ...]
    name: str
    """The number if the user is not known on this machine."""


@dataclass(frozen=True, slots=True)
class Said:
    """git's answer: exit code 0 for yes; 124 and 137 if it was ended."""

    code: int
    text: str

    @property
    def yes(self) -> bool:
        return self.code == 0


def git_command(directory: Path | str, *words: str) -> str:
    """A command of git for a person, who may be in any directory, with quotes for a shell."""
    return shlex.join(["git", "-C", os.path.abspath(directory), *words])


def repository(directory: Path) -> Path | None:
    """The `.git` that git finds for a directory, going up: a directory, or the file of a worktree. None outside of a
    repository."""
    here = Path(os.path.realpath(directory))
    return next((f / ".git" for f in (here, *here.parents) if os.path.lexists(f / ".git")), None)


def owner_of(path: Path) -> Owner | None:
    """The owner of a repository; None if that is this user, or if this process cannot act for others anyway."""
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


def begin_git(
    words: Sequence[str],
    owner: Owner | None = None,
    environment: Mapping[str, str] | None = None,
    stdin: int | IO[bytes] = subprocess.DEVNULL,
    stdout: int | IO[bytes] = subprocess.PIPE,
    stderr: int = subprocess.DEVNULL,
) -> subprocess.Popen[bytes]:
    """Start git. Raises OSError.

    As an `owner`, nothing in their repository's configuration (hooks, filters, programs) runs as root; git itself
    refuses repositories of other users (safe.directory). If the kernel does not allow it (no CAP_SETUID), git runs as
    this user, and refuses. Our own configuration applies only if git runs as this user.
    """
    own = os.path.expanduser("~") if owner is None else ""
    try:
        return subprocess.Popen(
            ["git", *SAFE, *words],
            stdin=stdin,
            stdout=stdout,
            stderr=stderr,
            umask=0o022,  # what it writes must stay readable for those who could read the tree
            env={**CLEAN, **({"HOME": own} if own else {}), **(environment or {})},
            start_new_session=True,
            user=owner.uid if owner else None,
            group=owner.gid if owner else None,
            extra_groups=owner.groups if owner else None,
        )
    except PermissionError:
        if owner is None:
            raise
        return begin_git(words, None, environment, stdin, stdout, stderr)


def ask_git(
    directory: Path,
    *words: str,
    patience: float = PATIENCE,
    environment: Mapping[str, str] | None = None,
    errors: bool = False,
) -> Said:
    """Run git in a directory, as the owner of its repository; see run_git()."""
    git_path = repository(directory)
    return run_git(
        ["-C", str(directory), *words], owner_of(git_path) if git_path else None, patience, environment, errors
    )


def git_text(directory: Path, *words: str) -> str:
    """git's output in a directory; empty if git refuses, prints too much, or takes too long."""
    said = ask_git(directory, *words)
    return said.text if said.yes else ""


def run_git(
    words: Sequence[str],
    owner: Owner | None = None,
    patience: float = PATIENCE,
    environment: Mapping[str, str] | None = None,
    errors: bool = False,
    stop: threading.Event | None = None,
) -> Said:
    """Run git to its end, for at most so many seconds, or until `stop` is set: then SIGTERM ends it and its children,
    and it removes its locks. `errors`: error messages are part of the answer. `owner` and `environment`: see
    begin_git()."""
    try:
        process = begin_git(words, owner, environment, stderr=subprocess.STDOUT if errors else subprocess.DEVNULL)
    except OSError as error:
        return Said(MISSING, f"git: {error.strerror}")
    output = Output(patience, stop)
    try:
        code = listen(process, output)
        return Said(code, output.text().decode(errors="replace").strip())
    except Exceeded as why:
        end(process, signal.SIGTERM)
        return Said(why.code, why.why)
