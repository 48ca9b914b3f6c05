"""One deadline for a whole attempt. A socket's timeout is for a single read, so an answer of one byte a second never
reaches it."""

from __future__ import annotations

import time
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Deadline:
    """`at` is a time of the monotonic clock, in seconds."""

    at: float

    @classmethod
    def within(cls, seconds: float) -> Deadline:
        return cls(time.monotonic() + seconds)

    def left(self) -> float:
        """Seconds that are left, more than 0. Raises TimeoutError if none are."""
        left = self.at - time.monotonic()
        if left <= 0:
            raise TimeoutError("timed out")
        return left

    def sooner(self, seconds: float) -> Deadline:
        """The earlier one of this deadline and the one in so many seconds."""
        return min(self, Deadline.within(seconds), key=lambda deadline: deadline.at)
