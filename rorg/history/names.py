"""What a revision is called on a command line and in the API."""

from __future__ import annotations

import re
from typing import Protocol

from rorg.history.revisions import Revision

NUMBER = re.compile(r"[0-9]{1,6}")
"""Of `rorg history`. Git shortens no commit to fewer than seven digits by itself."""


class Numbered(Protocol):
    """What has revisions by their numbers."""

    def get(self, number: int) -> Revision | None:
        """With its services."""


def parse(text: str, revisions: Numbered) -> Revision | str:
    """The revision of that number, where there is one; else the text, for git to understand: a commit, a tag, a branch,
    HEAD~2."""
    found = revisions.get(int(text)) if text.isascii() and NUMBER.fullmatch(text) else None
    return found or text
