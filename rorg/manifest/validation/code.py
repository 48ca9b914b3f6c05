"""What holds of all findings of one code."""

from __future__ import annotations

from typing import NamedTuple

ERROR, WARNING = "error", "warning"


class Code(NamedTuple):
    """What holds of all findings of one code."""

    severity: str
    """error: it can never work, and the tree is refused. A finding may be milder than its code."""
    cause: str
    """Why it is one: what happens to the robot."""
    remedy: str
    """What to try, in words that follow "try"."""
    machine: bool = False
    """Found only by `rorg validate --machine`."""
