"""Programs that request, look and release at random intervals, with nothing that lingers; and what they were told,
held against the engine."""

from __future__ import annotations

import random
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path

from robots import Daemon
from tools import tool

PROGRAMS = Path(__file__).parent / "programs"
SERVICES = {
    "always": {"always_on": True},
    "cam": {"idle": {"action": "pause", "linger": 0}},
    "loc": {"idle": {"action": "pause", "linger": 0}},
    "nav": {"needs": ["loc"], "idle": {"action": "stop", "linger": 0}, "container": {"stop_grace_period": "1s"}},
    "arm": {"idle": {"action": "stop", "linger": 0}, "container": {"stop_grace_period": "1s"}},
}
NEEDS = {"nav": ("nav", "loc")}


@dataclass
class Result:
    cycles: int = 0
    wrong: list[str] = field(default_factory=list)
    """Told ready, and found another state or another run while it held the request."""
    errors: list[str] = field(default_factory=list)
    longest: float = 0.0
    """Seconds from a request to ready."""


def commands(cpp: Path | None) -> list[list[str]]:
    """The programs by their command line, without the address."""
    python = [[sys.executable, str(PROGRAMS / f"cycle_{kind}.py")] for kind in ("sync", "asyncio")]
    return [*python, *([[str(cpp)]] if cpp else [])]


def compile_cpp(folder: Path, headers: Path) -> Path:
    made = folder / "cycle"
    source = PROGRAMS / "cycle.cpp"
    subprocess.run([tool("g++"), "-std=c++17", "-O0", "-pthread", "-I", headers, source, "-o", made], check=True)
    return made


def cycle(
    daemon: Daemon,
    programs: Sequence[Sequence[str]],
    count: int,
    between: Callable[[int], None] = lambda _: None,
    seed: int = 1,
) -> Result:
    """`count` cycles of each program, all at the same time. `between(n)` is called beside them, again and again, with
    the number of cycles so far."""
    result, lock, over = Result(), threading.Lock(), threading.Event()

    def play(number: int) -> None:
        chance = random.Random(seed * 1000 + number)
        program = subprocess.Popen(
            [*programs[number], daemon.robot.socket()], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert program.stdin
        assert program.stdout
        for _ in range(count):
            service = chance.choice(("cam", "nav", "arm", "loc"))
            began = time.monotonic()
            print(service, file=program.stdin, flush=True)
            told = program.stdout.readline().strip()
            took = time.monotonic() - began
            wrong = [] if told != "ready" else look(NEEDS.get(service, (service,)), chance)
            errors = [] if told == "ready" else [told]
            if told == "ready":
                print("release", file=program.stdin, flush=True)
                said = program.stdout.readline().strip()
                errors += [] if said == "released" else [said]
            time.sleep(chance.choice((0.0, 0.0, 0.01, 0.05)))
            with lock:
                result.cycles += 1
                result.wrong += wrong
                result.errors += [f"{programs[number][-1]}: {e}" for e in errors]
                result.longest = max(result.longest, took)
        program.stdin.close()
        program.wait(30)

    def look(names: Sequence[str], chance: random.Random) -> list[str]:
        before = {n: daemon.robot.container(n) for n in names}
        time.sleep(chance.choice((0.0, 0.0, 0.005, 0.03)))
        after = {n: daemon.robot.container(n) for n in names}
        return [
            f"{n}: {before[n].state} {before[n].incarnation} -> {after[n].state} {after[n].incarnation}"
            for n in names
            if (before[n].state, after[n].state) != ("running", "running")
            or before[n].incarnation != after[n].incarnation
        ]

    def disturb() -> None:
        while not over.wait(0.01):
            between(result.cycles)

    beside = threading.Thread(target=disturb, daemon=True)
    beside.start()
    with ThreadPoolExecutor(len(programs)) as pool:
        list(pool.map(play, range(len(programs))))
    over.set()
    beside.join(60)
    return result


class Restarts:
    """Ends rorg by SIGTERM and SIGKILL in turn, each time after so many cycles, and starts it again."""

    def __init__(self, daemon: Daemon, every: int) -> None:
        self.daemon, self.every, self.count = daemon, every, 0

    def __call__(self, cycles: int) -> None:
        if cycles >= (self.count + 1) * self.every:
            self.count += 1
            if self.count % 2:
                self.daemon.stop()
            else:
                self.daemon.kill()
            self.daemon.start()
