"""Which repository is followed: what names it, whose it is where it lies on this machine, and how it may be shown."""

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
"""What stands before the path: there an @ parts a user and a host."""
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
"""git's other end, for a repository of another user on this machine. Without the right to be them it refuses."""


@dataclass(frozen=True, slots=True)
class Remote:
    """A repository, and the branch of it that counts: the one that it is at itself, without a name."""

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
        """Where it lies on this machine; None for one elsewhere."""
        found = self.url.removeprefix("file://")
        return None if _REMOTE.match(found) else Path(found)

    @property
    def git(self) -> Path | None:
        """The directory of a local one in which its references are: `.git`, or itself where it is bare."""
        if self.local is None:
            return None
        inner = self.local / ".git"
        if inner.is_file():  # of a worktree, or of a submodule
            named = inner.read_text(errors="replace").removeprefix("gitdir:").strip()
            return self.local / named
        return inner if inner.is_dir() else self.local

    @property
    def owner(self) -> Owner | None:
        """Another user, whose it is, for root."""
        return owner_of(self.git) if self.git is not None else None

    @property
    def upload_pack(self) -> str:
        """The command that gives what is asked for, run by a shell with the path behind it; empty for git's own."""
        if self.owner is None:
            return ""
        numbers = ",".join(map(str, (self.owner.uid, self.owner.gid, *self.owner.groups)))
        return shlex.join([sys.executable, "-I", "-S", "-c", _AS_OWNER, numbers])


def remote(text: str) -> Remote:
    """REPO[@BRANCH]. A directory is named from here, also one with an @ in its name. Raises ValueError."""
    repository, branch = text, ""
    start = len((_BEFORE_PATH.match(text) or [""])[0])
    if "@" in text[start:] and not (start == 0 and os.path.isdir(text)):
        path, _, branch = text[start:].rpartition("@")
        repository = text[:start] + path
        if not re.fullmatch(_BRANCH, branch) or ".." in branch or branch.endswith(("/", ".", ".lock")):
            raise ValueError(f"'{branch}' is no name of a branch")
    if not repository or repository.startswith("-"):
        raise ValueError("no repository is named")
    if not _REMOTE.match(repository):
        repository = os.path.abspath(os.path.expanduser(repository))
    return Remote(repository, branch)


def without_user(text: str) -> str:
    """A text without what stands before the host in URLs: a password, or a token in the place of a user."""
    return _USER.sub("://***@", text)
