"""What a pass has found, for the next one to go on with."""

from __future__ import annotations

from dataclasses import dataclass

from rorg.core.follow import Followed
from rorg.core.observed import Observed
from rorg.core.onward import Planned
from rorg.core.schedule import Schedule


@dataclass(frozen=True, slots=True, kw_only=True)
class Hand:
    """It holds no memory of a pass, lest that hold the hand before."""

    observed: Observed
    followed: Followed
    planned: Planned
    schedule: Schedule
