"""Runs `rorg` with the words that follow, on a clock that is set: stepped.py FILE WORDS...

The file holds the seconds by which the clock is off, and may be written at any time. The clock that only counts
(monotonic) is not affected, as when NTP sets the time of a machine."""

import os
import sys
import time
from collections.abc import Callable

from rorg.cli.main import run


def stepped(clock: Callable[[], float], path: str) -> Callable[[], float]:
    known, offset = -1, 0.0

    def now() -> float:
        nonlocal known, offset
        written = os.stat(path).st_mtime_ns
        if written != known:
            with open(path) as file:
                known, offset = written, float(file.read() or 0.0)
        return clock() + offset

    return now


if __name__ == "__main__":
    time.time = stepped(time.time, sys.argv.pop(1))
    sys.argv[0] = "rorg"
    run()
