"""Back-off after failures: how long to wait before the next attempt."""

CAP = 60.0
"""Seconds. Kubernetes waits up to five minutes, but on a robot someone is usually waiting next to it."""
STABLE = 60.0
"""Seconds after which a run counts as stable and earlier exits are forgotten."""
STALLED_AFTER = 3
"""A service is Stalled after this many identical actions in a row without any observed change."""


def delay(failures: int) -> float:
    """Return seconds to wait after this many failures in a row: 0 after the first, then 1, 2, 4 and so on up to CAP."""
    return 0.0 if failures <= 1 else min(2.0 ** min(failures - 2, 10), CAP)
