"""Names of revisions, on a command line and in the API."""

from __future__ import annotations

import re
from typing import Protocol

from rorg.errors import Invalid
from rorg.history.revisions import Revision

NUMBER = re.compile(r"[0-9]{1,6}")
"""Numbers as in `rorg history`. git never abbreviates a commit to fewer than seven digits by default."""


class Numbered(Protocol):
    """Has revisions by number."""

    def get(self, number: int) -> Revision | None:
        """With its services."""


def parse(text: str, revisions: Numbered) -> Revision | str:
    """The revision of that number, if there is one; otherwise the text, for git: a commit, a tag, a branch, HEAD~2."""
    found = revisions.get(int(text)) if text.isascii() and NUMBER.fullmatch(text) else None
    return found or text


def for_git(text: str, revisions: Numbered) -> str:
    """The same for git: of a revision its commit. Raises Invalid if no commit has that revision."""
    found = parse(text, revisions)
    if not isinstance(found, Revision):
        return found
    if found.dirty or not found.commit:
        why = "its manifests were not all committed" if found.commit else "its tree was in no repository"
        raise Invalid(f"read the manifests of revision {found.number}", why, f"`rorg history show {found.number}`")
    return found.commit
