"""Images that containers are to be made from and that are not on the machine."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Missing:
    """Of one image."""

    reason: str
    """What is done about it, or why it cannot be had."""
    failed: bool = False
    """Waiting alone does not help."""
