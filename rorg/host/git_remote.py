"""The repository that is followed: its name, its owner if it is on this machine, and how it may be shown."""

from __future__ import annotations

import os
import re
import shlex
import sys
from dataclasses import dataclass
from pathlib import Path

from rorg.host.git_process import Owner, owner_of

_BRANCH = r"[^\s~^:?*\[\\@-][^\s~^:?*\[\\@]*"
"""As git allows them (git-check-ref-format), without those with an @."""
_REMOTE = re.compile(r"[a-z][a-z0-9+.-]*://|[^/]*:", re.IGNORECASE)
"""A URL, or HOST:PATH of ssh; anything else is a path."""
_BEFORE_PATH = re.compile(r"[a-z][a-z0-9+.-]*://[^/]*|[^/:]*:|", re.IGNORECASE)
"""The part before the path, in which an @ separates user and host."""
_USER = re.compile(r"://[^\s/@]+@")
_AS_OWNER = """\
import os, sys
uid, gid, *groups = map(int, sys.argv[1].split(","))
try:
    os.setgroups(groups), os.setgid(gid), os.setuid(uid), os.environ.pop("HOME", "")
except PermissionError:
    pass
os.execv("/usr/bin/env", ["env", "git", "upload-pack", *sys.argv[2:]])
"""
"""git's other end, for a repository of another user on this machine. If the process cannot become that user, git
refuses."""


@dataclass(frozen=True, slots=True)
class Remote:
    """A repository and the branch that is followed; without a name, its current branch."""

    url: str
    branch: str = ""

    @property
    def shown(self) -> str:
        """Without the user and the password of a URL."""
        return without_user(self.url)

    @property
    def source(self) -> str:
        """Its branch as a reference."""
        return f"refs/heads/{self.branch}" if self.branch else "HEAD"

    @property
    def local(self) -> Path | None:
        """Its path on this machine; None if it is on another."""
        path = self.url.removeprefix("file://")
        return None if _REMOTE.match(path) else Path(path)

    @property
    def git(self) -> Path | None:
        """The directory with the references of a local one: `.git`, or itself if it is bare."""
        if self.local is None:
            return None
        inner = self.local / ".git"
        if inner.is_file():  # of a worktree, or of a submodule
            named = inner.read_text(errors="replace").removeprefix("gitdir:").strip()
            return self.local / named
        return inner if inner.is_dir() else self.local

    @property
    def owner(self) -> Owner | None:
        """Its owner, if that is another user and this process is root."""
        return owner_of(self.git) if self.git is not None else None

    @property
    def upload_pack(self) -> str:
        """The command that serves a fetch, run by a shell with the path appended; empty for git's own."""
        if self.owner is None:
            return ""
        numbers = ",".join(map(str, (self.owner.uid, self.owner.gid, *self.owner.groups)))
        return shlex.join([sys.executable, "-I", "-S", "-c", _AS_OWNER, numbers])


def remote(text: str) -> Remote:
    """Parse REPO[@BRANCH]. A path is relative to the current directory; an existing one may have an @ in its name.
    Raises ValueError."""
    repository, branch = text, ""
    start = len((_BEFORE_PATH.match(text) or [""])[0])
    if "@" in text[start:] and not (start == 0 and os.path.isdir(text)):
        path, _, branch = text[start:].rpartition("@")
        repository = text[:start] + path
        if not re.fullmatch(_BRANCH, branch) or ".." in branch or branch.endswith(("/", ".", ".lock")):
            raise ValueError(f"'{branch}' is not a valid branch name")
    if not repository or repository.startswith("-"):
        raise ValueError("the repository is missing")
    if not _REMOTE.match(repository):
        repository = os.path.abspath(os.path.expanduser(repository))
    return Remote(repository, branch)


def without_user(text: str) -> str:
    """Remove what comes before the host in URLs: a password, or a token in the place of a user."""
    return _USER.sub("://***@", text)
