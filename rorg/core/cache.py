"""What a pass has found, for the next one to go on with; without it the same is found anew."""

from __future__ import annotations

from dataclasses import dataclass

from rorg.core.follow import Followed
from rorg.core.onward import Planned
from rorg.core.schedule import Schedule


@dataclass(frozen=True, slots=True, kw_only=True)
class Cache:
    """Each part says what it was found from."""

    followed: Followed
    planned: Planned
    schedule: Schedule
