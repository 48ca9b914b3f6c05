"""Services that work, and changes of them."""

from __future__ import annotations

WELL = {"always_on": True}


def changed(n: int, **more) -> dict:
    """Another edition of a service."""
    return {**WELL, "container": {"environment": {"N": str(n)}}, **more}
