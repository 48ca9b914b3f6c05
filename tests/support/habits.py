"""What was learnt from requests, for services that are prewarmed."""

from __future__ import annotations

from rorg.model.learned import Departure, Learned

AUTO = {"idle": {"action": "pause", "prewarm": "auto"}}


def habits(*followers: tuple[str, float], by: str = "developer", first: str = "ears") -> Learned:
    """Ten times each: so long after the first service, the requester asked for another one."""
    departures = tuple(Departure(after, (name,)) for name, after in followers for _ in range(10))
    return Learned({by: {(first,): departures}})
