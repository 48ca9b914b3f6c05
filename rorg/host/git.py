"""What git says of a tree. The git revision is information; nothing is decided by it but when to read."""

from __future__ import annotations

import subprocess
from pathlib import Path


def _git(directory: Path, *args: str) -> str | None:
    try:
        done = subprocess.run(["git", "-C", str(directory), *args], capture_output=True, text=True, timeout=5,
                              check=True, env={"PATH": "/usr/local/bin:/usr/bin:/bin", "LC_ALL": "C",
                                               "GIT_OPTIONAL_LOCKS": "0"})
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def git_dir(directory: Path) -> Path | None:
    """The repository's folder (.git, or a worktree's), or None outside of one."""
    found = _git(directory, "rev-parse", "--absolute-git-dir")
    return Path(found) if found else None


def revision(directory: Path) -> str:
    """Short commit of the tree, with `+` when files differ from it; empty outside of a repository."""
    commit = _git(directory, "rev-parse", "--short", "HEAD")
    if not commit:
        return ""
    return commit + ("+" if _git(directory, "status", "--porcelain", "--", str(directory)) else "")


def checkout_under_way(git: Path | None) -> bool:
    """git holds index.lock while it writes a work tree (checkout, merge, revert, reset): half is not to be read."""
    return git is not None and (git / "index.lock").exists()


def commit(root: Path, path: Path, author: str, message: str) -> bool:
    """Commits one file, alone, whatever else is staged; False outside of a repository, or when git says no."""
    if git_dir(root) is None:
        return False
    who = ("-c", f"user.name={author}", "-c", f"user.email={author.replace(' ', '.')}@rorg.local")
    _git(root, "add", "--all", "--", str(path))
    return _git(root, *who, "commit", "--quiet", "--message", message, "--only", "--", str(path)) is not None
