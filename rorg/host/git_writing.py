"""A commit that brings files back to how they were in another one. It is made first as an object that nothing refers
to, so that it can be looked at before anybody agrees; then git takes branch, index and work tree there in one step."""

from __future__ import annotations

import os
import shlex
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from rorg.errors import Refused
from rorg.host.git import COMMIT_PATIENCE, SAFE, identity
from rorg.host.person import Person

SHORT = 12
"""Digits of a commit in what people read and paste."""
MAGIC = frozenset("*?[]\\:!^")
"""What git takes for more than a path."""
NAMES = ("GIT_AUTHOR_NAME", "GIT_AUTHOR_EMAIL", "GIT_COMMITTER_NAME", "GIT_COMMITTER_EMAIL")


@dataclass(frozen=True, slots=True)
class Restoring:
    """What a commit is to restore."""

    top: Path
    """Of the work tree."""
    source: str
    """The commit, in full, whose files come back."""
    paths: tuple[str, ...]
    """Below `top`; `.` for all. What the source does not have of them goes."""
    message: str

    def commands(self, clone: bool = False) -> list[str]:
        """The same for a shell, line by line; in a `clone` with the push that publishes it. Empty where there is
        nothing of these paths. Raises Refused."""
        place = [] if clone else ["-C", str(self.top)]
        there = self._there("HEAD")
        paths = ["--", *(f":(literal){p}" if MAGIC & set(p) else p for p in there)]
        lines = [
            ["restore", f"--source={self.source[:SHORT]}", "--staged", "--worktree", *paths],
            ["commit", f"--message={self.message}", *paths],
            *([["push"]] if clone else []),
        ]
        return [shlex.join(["git", *place, *words]) for words in lines if there]

    def commit(self, person: Person, environment: Mapping[str, str]) -> str:
        """Makes the commit on top of the one that is checked out, as this person; it is returned in full, and nothing
        refers to it. Empty where it would change nothing. Raises Refused with what git says."""
        head = self._git("rev-parse", "--verify", "HEAD^{commit}")
        there = self._there(head)
        if not there:
            return ""
        with tempfile.TemporaryDirectory(prefix="rorg-index-") as folder:
            index = {"GIT_INDEX_FILE": f"{folder}/index"}
            self._git("read-tree", head, environment=index)
            self._git("restore", f"--source={self.source}", "--staged", "--", *there, environment=index)
            tree = self._git("write-tree", environment=index)
        if tree == self._git("rev-parse", f"{head}^{{tree}}"):
            return ""
        who = self._who(person, environment)
        return self._git("commit-tree", tree, "-p", head, "-m", self.message, environment=who)

    def take(self, commit: str) -> None:
        """Goes there. Raises Refused, with nothing changed, where something else has been committed since, or where
        what is not committed would be lost."""
        self._git("merge", "--ff-only", "--no-autostash", "--quiet", commit)

    def changed(self) -> list[str]:
        """Files that git knows and that are not as they were committed, by their paths below `top`."""
        return self._status("--untracked-files=no")

    def unknown(self) -> list[str]:
        """Files that git neither knows nor ignores."""
        return [path for path in self._status("--untracked-files=all") if path not in set(self.changed())]

    def _status(self, which: str) -> list[str]:
        words = ("status", "--porcelain", "-z", "--no-renames", "--ignore-submodules", which, "--", *self.paths)
        return [line[3:] for line in self._git(*words).split("\0") if line]

    def _there(self, head: str) -> list[str]:
        """Those of the paths that one of the two commits has: git refuses others."""
        return [p for p in self.paths if p == "." or any(self._has(c, p) for c in (head, self.source))]

    def _has(self, commit: str, path: str) -> bool:
        return bool(self._git("ls-tree", "--full-tree", "--name-only", commit, "--", path))

    def _who(self, person: Person, environment: Mapping[str, str]) -> dict[str, str]:
        """By the variables of git, the person's configuration or the repository's; else by the name of the user."""
        found = identity(person.home) | {name: environment[name] for name in NAMES if environment.get(name)}
        if "GIT_AUTHOR_NAME" not in found and not self._git("config", "--default", "", "--get", "user.name"):
            found = dict(zip(NAMES, 2 * (person.name, f"{person.name}@rorg.local"), strict=True)) | found
        return found

    def _git(self, *words: str, environment: Mapping[str, str] | None = None) -> str:
        """What it says. Raises Refused."""
        return said(self.top, f"restore {self.source[:SHORT]} in {self.top}", *words, environment=environment)


def said(directory: Path, what: str, *words: str, environment: Mapping[str, str] | None = None) -> str:
    """What git says of it. Raises Refused, as not doing `what`, with git's reason."""
    clean = {"PATH": "/usr/local/bin:/usr/bin:/bin", "LC_ALL": "C", "GIT_LITERAL_PATHSPECS": "1"}
    try:
        done = subprocess.run(
            ["git", *SAFE, "-C", str(directory), *words],
            stdin=subprocess.DEVNULL,
            capture_output=True,
            umask=0o022,
            env={**clean, **(environment or {})},
            timeout=COMMIT_PATIENCE,
        )
    except OSError as error:
        raise Refused(what, f"git: {error.strerror}", "installing git") from error
    except subprocess.TimeoutExpired as error:
        raise Refused(what, f"`git {words[0]}` does not end within {COMMIT_PATIENCE:g} s", "it by hand") from error
    if done.returncode:
        why = os.fsdecode(done.stderr or done.stdout).strip()
        raise Refused(what, f"git says: {why or f'`git {words[0]}` fails'}", "git's advice, then again")
    return os.fsdecode(done.stdout).rstrip("\n")
