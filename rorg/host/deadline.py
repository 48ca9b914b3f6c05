"""One end for a whole attempt. A time-out of a socket is that of one read: an answer of one byte a second never runs
into it."""

from __future__ import annotations

import time
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Deadline:
    """`at` is a time of the monotonic clock, seconds."""

    at: float

    @classmethod
    def within(cls, seconds: float) -> Deadline:
        return cls(time.monotonic() + seconds)

    def left(self) -> float:
        """Seconds, more than 0. Raises TimeoutError once there are none."""
        left = self.at - time.monotonic()
        if left <= 0:
            raise TimeoutError("timed out")
        return left

    def sooner(self, seconds: float) -> Deadline:
        """This one, or the one after so many seconds if that comes first."""
        return min(self, Deadline.within(seconds), key=lambda deadline: deadline.at)
