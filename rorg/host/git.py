"""Answers of git about a tree. The revision is information: the only decision that depends on it is when to read."""

from __future__ import annotations

import contextlib
import os
import shlex
import socket
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import psutil

from rorg.host.git_process import ask_git, git_text, repository, run_git
from rorg.host.person import Person, called
from rorg.model.units import stamp

COMMIT_PATIENCE = 60.0
"""Seconds for a commit: a hook may run."""
STALE = 600.0
"""Seconds after which index.lock must be of a killed git."""
AGAIN = 0.1
"""Seconds between two checks of a lock."""
NAMES = ("GIT_AUTHOR_NAME", "GIT_AUTHOR_EMAIL", "GIT_COMMITTER_NAME", "GIT_COMMITTER_EMAIL")
LONGEST = 200
"""Characters of an author or subject that are kept."""


@dataclass(frozen=True, slots=True)
class Commit:
    """A commit that a tree is at."""

    commit: str
    """The whole hash."""
    author: str
    """Who wrote it, by name."""
    subject: str
    """The first line of its message."""
    at: str
    """When it was committed: ISO 8601, UTC."""
    dirty: bool
    """Whether files of the tree differ from it."""


def identity(top: Path, person: Person, environment: Mapping[str, str]) -> dict[str, str]:
    """git's variables for the author and committer of a person's commit in the repository at `top`: from the
    environment, the person's configuration, or that of the repository and the machine; otherwise login@host. Root's own
    configuration counts for no one else."""
    known = configured_identity(person.home) | {name: environment[name] for name in NAMES if environment.get(name)}
    defaults = {"NAME": person.name, "EMAIL": f"{person.name.replace(' ', '.')}@{socket.gethostname()}"}
    for what, default in defaults.items():
        names = [name for name in NAMES if name.endswith(what)]
        if not known.keys() >= {*names}:
            words = ("config", "--get", f"user.{what.lower()}")
            found = ask_git(top, *words, environment={"GIT_CONFIG_GLOBAL": os.devnull})
            known = dict.fromkeys(names, (found.yes and found.text) or default) | known
    return known


def configured_identity(home: str) -> dict[str, str]:
    """Name and address in the git configuration of the person with this home, as git's variables."""
    variables: dict[str, str] = {}
    for what in ("NAME", "EMAIL") if home else ():
        words = ["-C", home, "config", "--global", "--get", f"user.{what.lower()}"]
        said = run_git(words, environment={"HOME": home})
        if said.yes and said.text:
            variables |= {name: said.text for name in NAMES if name.endswith(what)}
    return variables


def git_dir(directory: Path) -> Path | None:
    """The repository's folder (.git, or a worktree's), or None outside of one."""
    folder = git_text(directory, "rev-parse", "--absolute-git-dir")
    return Path(folder) if folder else None


def revision(directory: Path) -> str:
    """The short commit of the tree, with `+` if files differ from it; empty outside of a repository."""
    commit = git_text(directory, "rev-parse", "--short", "HEAD")
    if not commit:
        return ""
    return commit + ("+" if _differs(directory) else "")


def _differs(directory: Path) -> bool:
    """Whether files below a directory differ from the commit, or git does not say."""
    status = ask_git(directory, "status", "--porcelain", "--", str(directory))
    return not status.yes or bool(status.text)


def commit_of(directory: Path, name: str) -> str:
    """The commit that git understands by a name (HEAD~2, a tag, a branch); empty if there is none."""
    asked = f"{name}^{{commit}}"
    return git_text(directory, "rev-parse", "--verify", "--quiet", "--end-of-options", asked)


def refusal(directory: Path) -> str:
    """Why git refuses to answer about another user's repository, and what helps; empty if it does answer."""
    git_path = repository(directory)
    if git_path is None or "safe.directory" not in ask_git(directory, "rev-parse", errors=True).text:
        return ""
    return (
        f"git does not trust {git_path.parent}, since it is another user's: its revision is not known, and nothing is "
        f"committed there; try `git config --global --add safe.directory {shlex.quote(str(git_path.parent))}`"
    )


def head(directory: Path) -> Commit | None:
    """The commit of a tree; None outside of a repository, before its first commit, and if git refuses."""
    words = ("log", "-1", "--no-show-signature", "--encoding=UTF-8", "--format=%H%n%ct%n%an%n%s%n.")
    lines = git_text(directory, *words).split("\n")
    if len(lines) != 5:
        return None
    commit, seconds, author, subject, _ = lines
    try:
        at = stamp(int(seconds))
    except (OverflowError, ValueError, OSError):  # git takes any number
        at = ""
    return Commit(commit, author[:LONGEST], subject[:LONGEST], at, _differs(directory))


def head_stamp(git: Path | None) -> tuple[tuple[int, int], ...]:
    """Changes when another commit is checked out or made in the repository's folder `git`."""
    stamps = []
    for name in ("HEAD", "logs/HEAD"):
        with contextlib.suppress(OSError):
            stat = (git / name).stat() if git else None
            stamps += [(stat.st_mtime_ns, stat.st_size)] if stat else []
    return tuple(stamps)


def checkout_under_way(git: Path | None) -> bool:
    """Whether git is writing a work tree (checkout, merge, revert, reset): it holds index.lock meanwhile."""
    try:
        # A lock from the future is no younger: the clock was set back since, and git may have been killed long ago.
        return git is not None and abs(time.time() - (git / "index.lock").stat().st_mtime) < STALE
    except OSError:
        return False


def committed(root: Path, path: Path) -> bool:
    """Whether git has nothing to commit for a file; also true outside of a repository."""
    said = ask_git(root, "status", "--porcelain", "--", str(path))
    return (said.yes and not said.text) or git_dir(root) is None


def wait_for_locks(root: Path, since: float) -> None:
    """Wait for a git that a killed rorg has started and that still runs. If it was killed too, remove its locks: those
    made after `since` (seconds since the epoch) that no git at work in this repository is old enough to have made."""
    git, deadline = git_dir(root), time.monotonic() + COMMIT_PATIENCE
    while git and (left := _locks(git, since)) and time.monotonic() < deadline:
        begun = [
            p.info["create_time"] or 0.0
            for p in psutil.process_iter(["name", "create_time"])
            if p.info["name"] == "git" and _is_in(p, root)
        ]
        for lock, made in left.items():
            if all(at > made + AGAIN for at in begun):
                lock.unlink(missing_ok=True)
        time.sleep(AGAIN)


def _is_in(process: psutil.Process, root: Path) -> bool:
    """Whether a git works in the repository of this directory: it goes to the top of the work tree. A server, or a git
    of another repository, does not."""
    found = repository(root)
    try:
        return found is None or Path(process.cwd()).is_relative_to(found.parent)
    except psutil.AccessDenied:  # somebody else's: it may be
        return True
    except psutil.Error:
        return False


def _locks(git: Path, since: float) -> dict[Path, float]:
    """Each lock with the time when it was made."""
    locks = {}
    for lock in (*git.glob("*.lock"), *git.glob("refs/**/*.lock")):
        with contextlib.suppress(OSError):
            locks[lock] = lock.stat().st_mtime
    return {lock: made for lock, made in locks.items() if made >= since}


def commit(root: Path, path: Path, author: str, message: str, person: bool = False) -> bool:
    """Commit one file alone, even if others are staged; False outside of a repository, or if git refuses. `author` is
    the login of a `person`, whose git name counts, or another name."""
    if git_dir(root) is None:
        return False
    if person:
        known = called(author)
        who = identity(root, known, os.environ if known.uid == os.geteuid() else {})
    else:
        who = dict(zip(NAMES, 2 * (author, f"{author.replace(' ', '.')}@rorg.local"), strict=True))
    git_text(root, "add", "--all", "--", str(path))
    words = ("commit", "--quiet", "--message", message, "--only", "--", str(path))
    return ask_git(root, "-c", "commit.gpgSign=false", *words, patience=COMMIT_PATIENCE, environment=who).yes
