"""How long commands take: measured in processes of their own, for tests/bench."""

from __future__ import annotations

import os
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Callable

from rows import quiet

RORG = [sys.executable, "-m", "rorg"]

# The environment of a test run may forbid .pyc files, which a command of every day has.
ENVIRONMENT = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}


def timed(words: list[str], env: dict[str, str], code: int | None = 0) -> tuple[float, float]:
    """Milliseconds (on the clock, of CPU) of a process."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    done = subprocess.run(words, env=env, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    assert code is None or done.returncode == code, done.stdout + done.stderr
    return wall * 1000, (after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime) * 1000


def measure(
    what: str, words: list[str], env: dict[str, str], times: int = 15, before: Callable[[int], object] = lambda n: None
) -> float:
    """Prints the medians of a command, run in turn with a bare python; gives the one on the clock. `before` is called
    with a number before each."""
    bare, ours = [], []
    quiet()
    for n in range(times):
        before(n)
        bare.append(timed([sys.executable, "-c", ""], env))
        ours.append(timed(words, env))
    (wall, cpu), (bare_wall, bare_cpu) = (tuple(map(statistics.median, zip(*f, strict=True))) for f in (ours, bare))
    print(
        f"\n{what}: {wall:.0f} ms, CPU {cpu:.0f} ms; {wall / bare_wall:.1f} times a bare python's {bare_wall:.0f} ms, "
        f"{cpu / bare_cpu:.1f} times its CPU",
        end="",
    )
    return wall
