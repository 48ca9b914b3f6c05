"""Makes a commit that restores files as of another commit. It is first made as an object without a reference, so that
people can look at it before they agree; then git moves branch, index and work tree there in one step."""

from __future__ import annotations

import os
import shlex
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from rorg.errors import Refused
from rorg.host.git import COMMIT_PATIENCE, LONGEST, identity
from rorg.host.git_objects import said
from rorg.host.git_process import MISSING, ask_git, git_command, git_text, owner_of
from rorg.host.person import Person

SHORT = 12
"""Digits of a commit in text for people."""
MAGIC = frozenset("*?[]\\:!^")
"""Characters by which git takes a path for a pattern."""


def top_of(directory: Path) -> Path:
    """The top of a directory's work tree. Raises Refused, and TimedOut if git does not answer."""
    top = said(directory, "rev-parse", "--show-toplevel")
    if not top:
        why = f"{directory} is in no git repository that this user may read"
        status, init = (git_command(directory, word) for word in ("status", "init"))
        raise Refused(f"commit in {directory}", why, f"`{status}` for the reason, or `{init}`")
    return Path(top)


def subject_of(directory: Path, commit: str) -> str:
    """The first line of a commit's message."""
    return git_text(directory, "log", "-1", "--no-show-signature", "--encoding=UTF-8", "--format=%s", commit)[:LONGEST]


def changed(top: Path, *places: Path | str) -> list[str]:
    """Files below these places that differ from the commit, by their paths below `top`. Raises Refused."""
    names = [str(place) for place in places]
    words = ("diff", "--name-only", "--no-renames", "-z", "HEAD", "--", *names)
    return _asked(top, f"look at {', '.join(names)}", *words).split("\0")[:-1]


def unknown(top: Path, files: Sequence[str]) -> list[str]:
    """Those of these files that git does not know. Raises Refused."""
    known = set(_asked(top, f"look at {top}", "ls-files", "-z", "--", *files).split("\0")) if files else set()
    return [path for path in files if path not in known]


@dataclass(frozen=True, slots=True)
class Restoring:
    """What a commit restores."""

    top: Path
    """Of the work tree."""
    source: str
    """The commit, in full, whose files come back."""
    paths: tuple[str, ...]
    """Below `top`; `.` for all. Files that the source does not have are removed."""
    message: str

    def commands(self, clone: bool = False) -> list[str]:
        """The same for a shell, line by line; in a `clone` with the push that publishes it. Empty if nothing has these
        paths. Raises Refused."""
        there = self._there("HEAD")
        paths = ["--", *(f":(literal){p}" if MAGIC & set(p) else p for p in there)]
        lines = [
            ["restore", f"--source={self.source[:SHORT]}", "--staged", "--worktree", *paths],
            ["commit", f"--message={self.message}", *paths],
            *([["push"]] if clone else []),
        ]
        return [shlex.join(["git", *words]) if clone else git_command(self.top, *words) for words in lines if there]

    def commit(self, person: Person, environment: Mapping[str, str]) -> str:
        """Make the commit on top of the current one, as this person. Return it in full; nothing refers to it. Empty if
        it would change nothing. Raises Refused with git's reason."""
        head = self._git("rev-parse", "--verify", "HEAD^{commit}")
        there = self._there(head)
        if not there:
            return ""
        with tempfile.TemporaryDirectory(prefix="rorg-index-") as folder:
            owner = owner_of(self.top / ".git")
            if owner:
                os.chown(folder, owner.uid, owner.gid)
            index = {"GIT_INDEX_FILE": f"{folder}/index"}
            self._git("read-tree", head, environment=index)
            self._git("restore", f"--source={self.source}", "--staged", "--", *there, environment=index)
            tree = self._git("write-tree", environment=index)
        if tree == self._git("rev-parse", f"{head}^{{tree}}"):
            return ""
        who = identity(self.top, person, environment)
        return self._git("commit-tree", tree, "-p", head, "-m", self.message, environment=who)

    def differs(self) -> bool:
        """Return whether it would change anything. Raises Refused."""
        there = self._there("HEAD")
        return bool(there and self._git("diff", "--name-only", "HEAD", self.source, "--", *there))

    def files(self, commit: str) -> list[str]:
        """The files that a commit made here changes, below the work tree."""
        names = self._git("diff-tree", "-r", "-z", "--name-only", "--no-commit-id", commit)
        return [name for name in names.split("\0") if name]

    def take(self, commit: str) -> None:
        """Move there. Raises Refused, with nothing changed, if there is another commit since, or if uncommitted changes
        would be lost."""
        self._git("merge", "--ff-only", "--no-autostash", "--quiet", commit, told=True)

    def _there(self, head: str) -> list[str]:
        """Those of the paths that one of the two commits has: git refuses others."""
        return [p for p in self.paths if p == "." or any(self._has(c, p) for c in (head, self.source))]

    def _has(self, commit: str, path: str) -> bool:
        return bool(self._git("ls-tree", "--full-tree", "--name-only", commit, "--", path))

    def _git(self, *words: str, environment: Mapping[str, str] | None = None, told: bool = False) -> str:
        what = f"restore {self.source[:SHORT]} in {self.top}"
        return _asked(self.top, what, *words, environment=environment, told=told)


def _asked(top: Path, what: str, *words: str, environment: Mapping[str, str] | None = None, told: bool = False) -> str:
    """git's output, as the owner of the repository; with `told` also its errors. Raises Refused for `what`."""
    more = {"GIT_LITERAL_PATHSPECS": "1", **(environment or {})}
    said = ask_git(top, *words, patience=COMMIT_PATIENCE, environment=more, errors=told)
    if not said.yes:
        why = said.text if told or said.code == MISSING else f"`git {words[0]}` ends with {said.code}"
        raise Refused(what, why, f"`{git_command(top, 'status')}`")
    return said.text
