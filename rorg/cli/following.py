"""Which repository `rorg run` follows, from its options."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rorg.host.git_cache import Followed


def followed(directory: Path | None, git: str, path: str, committed: bool, signers: Path | None) -> Followed | None:
    """None where a directory is followed as it is. Raises Invalid."""
    from rorg.errors import Invalid
    from rorg.host.git_cache import Followed
    from rorg.host.git_remote import remote, without_user

    if not (git or committed):
        for option, given in (("--path", path), ("--signers", signers)):
            if given:
                raise Invalid(f"use {option}", "no repository is followed", "--git REPO, or --committed, with it")
        return None
    if git and (directory or committed):
        other = "DIRECTORY" if directory else "--committed"
        raise Invalid(f"follow {without_user(git)} and {other}", "it is one or the other", "`rorg run --help`")
    if signers and not signers.exists():
        raise Invalid(f"verify by {signers}", "no such file or directory", "a file of ssh signers, or a GnuPG home")
    trusted = signers.resolve() if signers else None
    if committed:
        return _own(directory or Path("manifests"), path, trusted)
    try:
        found = remote(git)
    except ValueError as error:
        raise Invalid(f"follow {without_user(git)}", str(error), "REPO or REPO@BRANCH") from error
    return Followed(found, _inner(path), trusted)


def _own(directory: Path, path: str, signers: Path | None) -> Followed:
    """The repository that a directory is in, wherever it is at."""
    from rorg.errors import Invalid
    from rorg.host.git_cache import Followed
    from rorg.host.git_process import repository
    from rorg.host.git_remote import Remote

    found = repository(directory)
    if found is None or not directory.is_dir():
        why = "it is in no git repository" if directory.is_dir() else "no such directory"
        raise Invalid(f"follow what is committed of {directory}", why, "`git init` and a commit, or no --committed")
    inner = directory.resolve().relative_to(found.parent) / _inner(path)
    return Followed(Remote(str(found.parent)), str(inner), signers, forward=False)


def _inner(path: str) -> str:
    """A directory of a repository. Raises Invalid."""
    from rorg.errors import Invalid

    if path.startswith("/") or ".." in Path(path).parts:
        raise Invalid(f"read manifests in {path}", "it is not inside of the repository", "--path DIR, from its top")
    return str(Path(path))
