"""How long to wait before trying again."""

CAP = 60.0
"""Seconds; a robot is looked at more often than a cluster, whose cap is five minutes."""
STABLE = 60.0
"""A run of so many seconds forgets earlier exits."""
STALLED_AFTER = 3
"""The same action, so often in a row with nothing observed to change: the service is Stalled."""


def delay(failures: int) -> float:
    """Seconds to wait after that many failures in a row: 0 after the first, then 1, 2, 4 and so on up to CAP."""
    return 0.0 if failures <= 1 else min(2.0 ** min(failures - 2, 10), CAP)
